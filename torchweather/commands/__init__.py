"""The commands of the ``torchweather`` program, one file each; torch is imported only when a command runs."""
