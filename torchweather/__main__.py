"""``python -m torchweather``: the same as the ``torchweather`` program."""

from __future__ import annotations

from torchweather.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
