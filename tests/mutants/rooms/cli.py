"""Breaks of the command line."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

CLI = "torchweather.cli.program"

MUTANTS = (
    Mutant(
        "nan_in_json",
        "JSON has no NaN",
        "torchweather.cli.output",
        "return value if math.isfinite(value) else None",
        "return value",
        ("tests/cli/test_cli.py::test_demo_hands_over_folder_and_seed",),
    ),
    Mutant(
        "mistake_ends_with_success",
        "a mistake ends with exit code 2",
        CLI,
        "MISTAKE = 2",
        "MISTAKE = 0",
        ("tests/cli/test_cli.py::test_a_mistake_gives_one_line_exit_code_2_and_no_file",),
    ),
    Mutant(
        "warnings_repeated",
        "a warning is shown once",
        CLI,
        "if text not in shown:",
        "if True:",
        ("tests/cli/test_cli_lidar.py::test_intensities_that_do_not_fit_the_sensor_are_said_once",),
    ),
    Mutant(
        "input_overwritten",
        "an input file is never written over",
        "torchweather.cli.result_files",
        "if resolved in self.inputs:",
        "if False:",
        ("tests/cli/test_cli_radar.py::test_a_mistake_gives_one_line_exit_code_2_and_no_file",),
    ),
    Mutant(
        "region_axis_given_twice",
        "an axis of a region is given once",
        "torchweather.cli.regions",
        " or name in limits:",
        ":",
        ("tests/cli/test_cli_metrics.py::test_a_mistake_gives_one_line_and_exit_code_2",),
    ),
    Mutant(
        "pairs_of_different_stems",
        "files are paired by name",
        "torchweather.cli.pairs_of_files",
        "if counts[0][name] == counts[1][name] == 1:",
        "if counts[0][name] == 1:",
        ("tests/cli/test_cli_metrics.py::test_nothing_that_matches_is_a_mistake",),
    ),
    Mutant(
        "a_bug_reported_as_a_mistake",
        "an error of the package itself is a traceback",
        CLI,
        "if args.debug or not is_mistake(error):",
        "if args.debug:",
        ("tests/cli/test_cli_bug.py::test_a_bug_is_no_mistake_of_the_user",),
    ),
    Mutant(
        "every_error_a_mistake",
        "a user's mistake is what the library raises on purpose, or a file",
        "torchweather.cli.mistakes",
        "return isinstance(error, (TorchweatherError, OSError))",
        "return True",
        ("tests/cli/test_cli_bug.py::test_a_bug_is_no_mistake_of_the_user",),
    ),
    Mutant(
        "any_value_error_a_mistake",
        "an unexpected ValueError is a defect of the package",
        "torchweather.cli.mistakes",
        "return isinstance(error, (TorchweatherError, OSError))",
        "return isinstance(error, (TorchweatherError, OSError, ValueError))",
        ("tests/cli/test_cli_bug.py::test_a_bug_is_no_mistake_of_the_user",),
    ),
)
