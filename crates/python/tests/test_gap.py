from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import program

import locsim


def test_a_hidden_effect_is_named(scenario: Path, tmp_path: Path) -> None:
    """A laser that reads 10 cm too far, and a scenario that doesn't say so."""
    nominal = locsim.Scenario(scenario).replace({"laser.rate_hz": 40, "laser.beams": 36, "blocks": None})
    hidden = nominal.replace({"effects": [{"name": "range_bias", "bias_m": 0.1}]})
    locsim.simulate(hidden).save(tmp_path / "measured.mcap")
    answer = locsim.gap(nominal, tmp_path / "measured.mcap", replicates=19, filter=False)
    assert answer.verdict in {"named", "ambiguous", "partly_explained"}
    candidates = {name for effect in answer.effects for name in effect["candidates"]}
    assert "range_bias" in candidates, str(answer)
    found = next(effect for effect in answer.effects if "range_bias" in effect["candidates"])
    assert answer.to_dict()["effects"][0]["name"] == answer.effects[0]["name"]
    assert found["evidence"]["p"] <= 0.05
    assert answer.text == str(answer)
    assert answer.out is None
    proposed = scenario.parent / "proposed.yaml"
    proposed.write_text(answer.scenario)
    effects = locsim.Scenario(proposed).to_dict()["effects"]
    assert len(effects) == len(answer.effects)


def test_what_changed_since_a_baseline_is_named(scenario: Path, tmp_path: Path) -> None:
    """A laser that reads 10 cm too far since yesterday, as the command says it."""
    nominal = locsim.Scenario(scenario).replace({"laser.rate_hz": 40, "laser.beams": 36, "blocks": None})
    hidden = nominal.replace({"effects": [{"name": "range_bias", "bias_m": 0.1}]})
    yesterday, today = tmp_path / "yesterday.mcap", tmp_path / "today.mcap"
    locsim.simulate(nominal).save(yesterday)
    locsim.simulate(hidden, seed=8).save(today)
    out = tmp_path / "out"
    answer = locsim.gap(nominal, today, out, baseline=yesterday, replicates=19)
    assert answer.verdict == "changed"
    assert [effect["name"] for effect in answer.effects] == ["range_bias"], str(answer)
    assert answer.text.startswith("Since the baseline: "), answer.text
    assert (out / "report.html").is_file()
    written = json.loads((out / "gap.json").read_text())
    assert answer.to_dict() == written
    assert written["baseline"]["effects"] == answer.effects
    assert answer.scenario == (out / "scenario.yaml").read_text()
    again = locsim.gap(nominal, today, baseline=yesterday, replicates=19)
    assert (again.effects, again.text, again.out) == (answer.effects, answer.text, None)
    same = locsim.gap(nominal, yesterday, baseline=yesterday, replicates=19)
    assert (same.verdict, same.effects) == ("none", [])


def test_what_is_refused(scenario: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="replicates: 5 is not allowed"):
        locsim.gap(scenario, replicates=5)
    with pytest.raises(ValueError, match="without: .*nonsense"):
        locsim.gap(scenario, without=["nonsense"])
    with pytest.raises(locsim.ScenarioError) as caught:
        locsim.gap(scenario)
    printed = program("gap", str(scenario), "--out", str(tmp_path / "out"))
    assert printed.stderr.strip() == f"error: {caught.value}"
