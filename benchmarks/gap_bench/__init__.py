"""Bench of the search for a missing effect, on studies in which an effect is hidden.

    python -m benchmarks.gap_bench make DIR --sensor lidar --set dev --seed 1 --cases singles nulls --count 20
    python -m benchmarks.gap_bench run DIR                  # resumable: one line of JSON a case
    python -m benchmarks.gap_bench known DIR                # opens the truth: how narrow intervals could be
    python -m benchmarks.gap_bench score DIR --out benchmarks/gap_bench/lidar
    python -m benchmarks.gap_bench keep DIR benchmarks/gap_bench/lidar/blind9

``make`` writes studies to ``DIR/studies`` and what is hidden in them to ``DIR/sealed/truth.json``, whose SHA-256 it
prints and keeps in ``DIR/seal.json``. ``run`` never opens the sealed folder; ``known`` and ``score`` do, so they come
after it. A set that led to a change of the workflow is a development set (``--set dev...``) from then on.

``generator/`` makes the studies; ``lidar/``, ``camera/`` and ``radar/`` hold the newest set of each sensor.
"""
