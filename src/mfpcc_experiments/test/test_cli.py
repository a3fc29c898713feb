"""The command `mfpcc`: what it does with its verbs, and what it says of a bad command line."""

from __future__ import annotations

import errno
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from harness import PATIENCE

from mfpcc_experiments import cli
from mfpcc_experiments.files import ResultFolderError, result_folder


class Fake:
    """Stands for the engines and the comparison: writes small files instead of running a drive."""

    def __init__(self) -> None:
        self.runs: list[tuple[str, str, str, int, bool]] = []
        self.scenarios: list[Any] = []
        self.window_s: Any = None
        self.compared: list[Path] = []
        self.failure: BaseException | None = None

    def run(
        self,
        scenario: Any,
        scheme: str,
        engine: str,
        out_dir: Path,
        seed: int,
        progress: Callable[[float], None],
        *,
        separate: bool = False,
        name: str | None = None,
    ) -> None:
        bag = out_dir / (name or scheme)
        bag.mkdir()
        (bag / f"{scheme}_0.mcap").write_bytes(bytes(100_000))
        progress(scenario.periods / 2)
        if self.failure is not None:
            raise self.failure
        self.scenarios.append(scenario)
        self.runs.append((scenario.name, scheme, engine, seed, separate))

    def compare(
        self,
        paths: Any,
        out: Path,
        *,
        window_s: Any = None,
        namespace: str | None = None,
        progress: Any = None,
    ) -> list[dict[str, Any]]:
        self.compared, self.window_s = list(paths), window_s
        (out / "metrics.json").write_text("[]")
        (out / "report.html").write_text("")
        progress(1.0)
        return [{"scheme": path.name, "notes": []} for path in paths]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Fake:
    """The engines and the comparison replaced, in an empty working directory."""
    stand_in = Fake()
    modules = {
        "running.run": SimpleNamespace(run=stand_in.run),
        "reporting.compare": SimpleNamespace(compare=stand_in.compare),
        "reporting.table": SimpleNamespace(
            print_table=lambda rows: print("table:", *(row["scheme"] for row in rows)),
        ),
        "bags.recover": SimpleNamespace(recover=lambda path: f"{path}: 10 messages saved"),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, f"mfpcc_experiments.{name}", module)  # type: ignore[arg-type]
        room, _, leaf = name.partition(".")
        package = importlib.import_module(f"mfpcc_experiments.{room}")
        monkeypatch.setattr(package, leaf, module, raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return stand_in


def mfpcc(line: str) -> int:
    return cli.run(line.split())


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# --- What it does -------------------------------------------------------------------------------


def test_help_and_list(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    assert mfpcc("") == 0
    assert "Usage: mfpcc" in capsys.readouterr().out
    assert mfpcc("--help") == 0
    out = capsys.readouterr().out
    for verb in ("list", "run", "compare", "recover"):
        assert f"  {verb} " in out
        assert mfpcc(f"{verb} --help") == 0
        assert f"Usage: mfpcc {verb}" in capsys.readouterr().out
    assert mfpcc("list") == 0
    out = capsys.readouterr().out
    for name in ("steady_750_2", "mismatch_c", "mls_mfpcc", "mbpcc", "seed_750", "ipmsm"):
        assert f"  {name}" in out


def test_run_records_each_scheme_and_compares(
    fake: Fake, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "run steady_750_2 --scheme mbpcc --scheme mfpcc --scheme mbpcc --out a/b --seed 3"
    assert mfpcc(line) == 0
    assert fake.runs == [
        ("steady_750_2", "mbpcc", "ros", 3, False),
        ("steady_750_2", "mfpcc", "ros", 3, False),
    ]
    assert names(Path("a")) == ["b"]
    assert names(Path("a/b")) == ["mbpcc", "metrics.json", "mfpcc", "report.html"]
    out = capsys.readouterr().out
    assert "table: mbpcc mfpcc" in out
    assert "report: a/b/report.html" in out


def test_run_without_options_takes_all_schemes_and_a_folder_of_that_name(fake: Fake) -> None:
    assert mfpcc("run load_step --engine inprocess") == 0
    assert {"mls_mfpcc", "mfpcc", "mbpcc"} <= {scheme for _, scheme, *_ in fake.runs}
    assert {engine for _, _, engine, *_ in fake.runs} == {"inprocess"}
    assert Path("out/load_step/metrics.json").is_file()


def test_run_takes_a_scenario_file_and_separate(fake: Fake) -> None:
    Path("my.yaml").write_text("motor: ipmsm\nduration: 0.1\nwindow_s: [0, 0.1]\n")
    assert mfpcc("run my.yaml --scheme mbpcc --separate") == 0
    assert fake.runs == [("my", "mbpcc", "ros", 0, True)]
    assert Path("out/my/report.html").is_file()


def test_run_takes_other_values_than_the_file(fake: Fake) -> None:
    assert (
        mfpcc(
            "run steady_750_2 --scheme mls_mfpcc --out one --set mls.window=10 --set load_torque=3"
            " --set duration=0.3 --set window_s=[0.1,0.3] --set plant.fault.react=false"
        )
        == 0
    )
    (found,) = fake.scenarios
    plant, controller = found.node_parameters("mls_mfpcc", 0)
    assert controller["mls.window"] == 10 and controller["fault.react"] is True
    assert plant["load_torque"] == 3.0 and plant["fault.react"] is False
    assert (found.duration, found.window_s) == (0.3, (0.1, 0.3))
    assert found.changes == {
        "mls.window": 10,
        "load_torque": 3.0,
        "duration": 0.3,
        "window_s": (0.1, 0.3),
        "plant.fault.react": False,
    }


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("mls.window=ten", "'mls.window' = 'ten' has the wrong type"),
        ("mls.window=1000000", "out of range"),
        ("mls.windw=10", "did you mean 'mls.window'"),
        ("mismatch.L=2", "did you mean 'mismatch.inductance'"),
        ("duraton=1", "did you mean 'duration'"),
        ("duration=long", "'duration' should be a valid number"),
        ("window_s=[0.1,9]", "'window_s' must be [start, end]"),
        ("motor=seed_75", "did you mean 'seed_750'"),
        ("fault.react=false", "'plant.fault.react' or 'controller.fault.react'"),
        ("scheme=mbpcc", "--scheme"),
        ("seed=3", "--seed"),
        ("inverter.dead_time=6e-5", "shorter than half a PWM period"),
        ("mls.window", "NAME=VALUE is expected"),
        ("=3", "NAME=VALUE is expected"),
    ],
)
def test_run_refuses_what_a_node_would_refuse(
    fake: Fake, capsys: pytest.CaptureFixture[str], change: str, said: str
) -> None:
    assert mfpcc(f"run steady_750_2 --out one --set {change}") == 2
    assert said in capsys.readouterr().err
    assert not fake.runs and not Path("one").exists()


@pytest.mark.parametrize("scheme", ["mls", "MLS"])
def test_a_scheme_is_told_from_a_part_of_its_name(
    fake: Fake, capsys: pytest.CaptureFixture[str], scheme: str
) -> None:
    assert mfpcc(f"run steady_750_2 --scheme {scheme} --out one") == 2
    assert "did you mean 'mls_mfpcc'" in capsys.readouterr().err


def test_compare_takes_a_window(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    assert mfpcc("run steady_750_2 --scheme mbpcc --out one") == 0
    assert fake.window_s is None
    assert mfpcc("compare one --window 0.1 0.25 --out two") == 0
    assert fake.window_s == (0.1, 0.25)
    for window in ("0.2 0.1", "0.2 0.2", "-1 0.2", "0.1 inf", "nan 0.1"):
        assert mfpcc(f"compare one --window {window} --out three") == 2
        assert "0 <= BEGIN < END" in capsys.readouterr().err
    assert mfpcc("compare one --window 0.1 soon --out three") == 2
    assert not Path("three").exists()


def test_compare_takes_bags_and_folders_of_bags(
    fake: Fake, capsys: pytest.CaptureFixture[str]
) -> None:
    assert mfpcc("run steady_750_2 --scheme mbpcc --scheme mfpcc --out one") == 0
    assert mfpcc("run steady_750_5 --scheme mbpcc --out two") == 0
    assert mfpcc("compare one two/mbpcc nowhere --out three") == 0
    assert [str(path) for path in fake.compared] == [
        "one/mbpcc",
        "one/mfpcc",
        "two/mbpcc",
        "nowhere",
    ]
    assert "report: three/report.html" in capsys.readouterr().out


def test_recover(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    assert mfpcc("recover one/mbpcc") == 0
    assert "one/mbpcc: 10 messages saved" in capsys.readouterr().out


@pytest.mark.usefixtures("no_vectors")
def test_a_real_run_in_process(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(
        "motor: seed_750\nspeed_rpm: 750\nduration: 0.2\nwindow_s: [0.15, 0.2]\n"
        "plant: {load_torque: 2.0, oversampling: 20}\n"
    )
    line = "run short.yaml --scheme mbpcc --scheme mls_mfpcc --engine inprocess --seed 5"
    assert mfpcc(line) == 0, capsys.readouterr().err
    out = tmp_path / "out" / "short"
    rows = json.loads((out / "metrics.json").read_text())
    assert [row["scheme"] for row in rows] == ["mbpcc", "mls_mfpcc"]
    for row in rows:
        assert (row["experiment"], row["engine"], row["seed"]) == ("short", "inprocess", 5)
        assert (row["periods"], row["lost_periods"]) == (2000, 0)
        assert 0.1 < row["thd_percent"]["oversampled"] < 5
    # What was the working folder's name must not be in what stays.
    assert (out / "report.html").stat().st_size > 10_000
    assert "partial-" not in (out / "report.html").read_text()
    assert "partial-" not in (out / "metrics.json").read_text()
    assert list((out / "figures").glob("*.png"))
    assert mfpcc("compare out/short --out out/again") == 0
    assert json.loads((tmp_path / "out/again/metrics.json").read_text()) == rows


# --- What it says -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("rn steady_750_2", ["unknown verb 'rn'", "did you mean 'run'", "compare, export, faults"]),
        ("--versoin", ["--versoin", "--version"]),
        ("run", ["EXPERIMENT", "mfpcc run --help"]),
        ("run a b", ["(b)"]),
        ("run steady_752_2", ["unknown experiment 'steady_752_2'", "did you mean 'steady_750_2'"]),
        ("run nowhere.yaml", ["nowhere.yaml", "no such file"]),
        ("run load_step --scheme mbpc", ["unknown scheme 'mbpc'", "did you mean 'mbpcc'"]),
        ("run load_step --engine roz", ["unknown engine 'roz'", "did you mean 'ros'"]),
        ("faults --engine roz", ["unknown engine 'roz'", "did you mean 'ros'"]),
        ("run load_step --shceme mbpcc", ["--shceme", "--scheme"]),
        ("run load_step --seed many", ["--seed", "many"]),
        ("run load_step --seed -1", ["--seed", "-1"]),
        ("run load_step --seed 99999999999999999999", ["seed"]),
        ("run load_step --engine inprocess --separate", ["--separate", "--engine ros"]),
        ("compare", ["BAG"]),
        ("recover", ["BAG"]),
    ],
)
def test_a_bad_command_line_is_one_line_and_2(
    fake: Fake, capsys: pytest.CaptureFixture[str], line: str, said: list[str]
) -> None:
    assert mfpcc(line) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("mfpcc: ")
    assert captured.err.count("\n") == 1
    for words in said:
        assert words in captured.err
    assert names(Path()) == []


def test_a_bad_scenario_file_is_told_and_1(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    Path("my.yaml").write_text("motor: ipmsm\nduraton: 0.1\nwindow_s: [0, 0.1]\n")
    assert mfpcc("run my.yaml") == 1
    error = capsys.readouterr().err
    assert "mfpcc: my.yaml: unknown key 'duraton'; did you mean 'duration'" in error
    assert "mfpcc: my.yaml: the key 'duration' is missing" in error
    assert "Traceback" not in error


def test_an_unexpected_error_is_one_line_and_the_traceback_goes_to_a_file(
    fake: Fake, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.failure = ZeroDivisionError("division\nby zero")
    assert mfpcc("run load_step") == 1
    error = capsys.readouterr().err
    assert "mfpcc: unexpected ZeroDivisionError: division by zero (this is a bug" in error
    assert "Traceback" not in error
    (report,) = Path().glob("mfpcc-error-*.txt")
    assert str(report.name) in error
    assert "Traceback" in report.read_text()


def test_an_error_of_the_system_is_no_bug(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    fake.failure = OSError(errno.ENOSPC, "No space left on device", "some.mcap")
    assert mfpcc("run load_step") == 1
    error = capsys.readouterr().err
    assert "mfpcc: some.mcap: No space left on device\n" in error
    (kept,) = Path("out").iterdir()
    assert f"is kept in {kept.resolve()}" in error


def test_without_the_workspace_it_says_what_to_source(
    fake: Fake, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.failure = ModuleNotFoundError("No module named 'rclpy'", name="rclpy")
    assert mfpcc("run load_step") == 1
    assert "'source setup.bash' first" in capsys.readouterr().err


def test_ctrl_c_is_130_and_no_traceback(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    fake.failure = KeyboardInterrupt()
    assert mfpcc("run load_step") == 130
    assert capsys.readouterr().err.endswith("mfpcc: interrupted\n")


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from mfpcc_experiments import cli; cli.run(['--help'])\n"
        "heavy = {'numpy', 'numba', 'matplotlib', 'pydantic', 'rich', 'rclpy', 'yaml'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or None)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr


def test_nothing_is_said_to_a_reader_that_has_gone() -> None:
    code = "import sys; from mfpcc_experiments import cli; sys.exit(cli.run())"
    with subprocess.Popen(
        [sys.executable, "-c", code, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""


# --- The folder of results ----------------------------------------------------------------------


def test_results_are_not_overwritten_without_force(
    fake: Fake, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "run load_step --out here --scheme"
    assert mfpcc(f"{line} mbpcc") == 0
    capsys.readouterr()
    assert mfpcc(f"{line} mfpcc") == 1
    error = capsys.readouterr().err
    assert "here exists" in error
    assert "--force" in error
    assert names(Path("here")) == ["mbpcc", "metrics.json", "report.html"]
    assert mfpcc(f"{line} mfpcc --force") == 0
    assert names(Path("here")) == ["metrics.json", "mfpcc", "report.html"]
    assert names(Path()) == ["here"]


def test_a_failed_run_leaves_the_results_before_it_alone(fake: Fake) -> None:
    assert mfpcc("run load_step --scheme mbpcc --out here") == 0
    fake.failure = OSError(errno.EIO, "Input/output error")
    assert mfpcc("run load_step --scheme mfpcc --out here --force") == 1
    assert names(Path("here")) == ["mbpcc", "metrics.json", "report.html"]


def fill(place: Path, name: str = "metrics.json", *, force: bool = False) -> None:
    """Make results of one large file; any but metrics.json stands for work that fails."""
    with result_folder(place, force=force) as folder:
        assert folder.parent == place.resolve().parent
        (folder / name).write_bytes(bytes(100_000))
        if name != "metrics.json":
            raise RuntimeError("the work failed")


def test_what_somebody_of_the_same_number_left_is_no_hindrance(tmp_path: Path) -> None:
    left = [f"here.{what}-{os.getpid()}" for what in ("partial", "replaced")]
    for name in left:
        (tmp_path / name).mkdir()
        (tmp_path / name / "kept").write_text("")
    fill(tmp_path / "here")
    fill(tmp_path / "here", force=True)
    assert names(tmp_path) == ["here", *left]
    assert all((tmp_path / name / "kept").exists() for name in left)


def test_folders_made_on_the_way_go_with_it(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError):
        fill(tmp_path / "a/b/c", "some.txt")
    assert names(tmp_path) == []


@pytest.mark.parametrize("force", [False, True])
def test_what_is_not_a_folder_of_results_is_never_replaced(tmp_path: Path, force: bool) -> None:
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter.tex").write_text("years of work")
    with pytest.raises(ResultFolderError, match="something else"):
        fill(thesis, force=force)
    with pytest.raises(ResultFolderError, match="is a file"):
        fill(thesis / "chapter.tex", force=force)
    assert (thesis / "chapter.tex").read_text() == "years of work"


def test_the_working_directory_is_never_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    monkeypatch.chdir(inside)
    for place in (Path("."), Path(".."), Path("/"), tmp_path):
        with pytest.raises(ResultFolderError, match="where you are"):
            fill(place, force=True)


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    place = tmp_path / "new" / "results"
    with result_folder(place) as folder:
        (folder / "metrics.json").write_text("[]")
        assert not place.exists()
    assert names(place.parent) == ["results"]
    assert names(place) == ["metrics.json"]


def test_an_empty_folder_and_a_link_to_results_are_filled(tmp_path: Path) -> None:
    place = tmp_path / "results"
    place.mkdir()
    fill(place)
    assert names(place) == ["metrics.json"]
    link = tmp_path / "link"
    link.symlink_to(place)
    fill(link, force=True)
    assert link.is_symlink()
    assert names(tmp_path) == ["link", "results"]


def test_failed_work_leaves_nothing_but_recordings(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError):
        fill(tmp_path / "results", "report.html")
    assert names(tmp_path) == []
    with pytest.raises(RuntimeError):
        fill(tmp_path / "results", "run_0.mcap")
    (kept,) = tmp_path.iterdir()
    assert kept.name.startswith("results.partial-")


def test_a_folder_that_appears_meanwhile_is_not_lost(tmp_path: Path) -> None:
    place = tmp_path / "results"
    work = result_folder(place)
    work.__enter__()
    fill(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").rename(place)
    with pytest.raises(ResultFolderError, match="exists"):
        work.__exit__(None, None, None)
    assert names(tmp_path) == ["results"]
