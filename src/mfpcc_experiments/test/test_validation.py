"""The proofs of `docs/validation.md`, over a shorter time."""

from __future__ import annotations

from mfpcc_experiments import cli
from mfpcc_experiments.proofs import effects


def test_all_limits_are_kept_and_all_figures_drawn(tmp_path, capsys, monkeypatch):
    (tmp_path / "docs/validation").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert cli.run(["validate", "--duration", "0.002", "--no-costs"]) == 0
    assert "EXCEEDED" not in capsys.readouterr().out
    assert not list((tmp_path / "docs/validation").iterdir())  # those are the project's
    assert {path.name for path in (tmp_path / "out/validation").iterdir()} == {
        "blocked_gates.png",
        "dc_link.png",
        "dead_time.png",
        "integration.png",
        "power_balance.png",
        "realistic.png",
        "saturation.png",
    }


def test_every_effect_can_be_timed():
    costs = effects.costs(repeats=1, periods=5)
    assert costs.keys() == effects.COSTED.keys()
    assert all(cost > 0.0 for cost in costs.values())
