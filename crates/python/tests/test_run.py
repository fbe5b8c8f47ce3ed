from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest
from conftest import program

import locsim


def test_tables_are_those_of_the_program(scenario: Path, ran: locsim.Run, tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out"
    assert program("run", str(scenario), "--out", str(out), "--record", "none", "--quiet").returncode == 0
    for name, table in ran.tables.items():
        assert pyarrow.table(table).equals(parquet.read_table(out / f"{name}.parquet")), name
    summary = json.loads((out / "summary.json").read_text())
    mine = ran.summary
    for each in [summary, mine]:
        del each["seconds"]
        for model in each["models"].values():
            del model["step_ms"]
    assert mine == summary
    assert ran.ratios == summary["ratios"]
    lo, value, hi = (ran.ratios["np_reg_registered"]["rmse_vs_classic"][key] for key in ["lo", "value", "hi"])
    assert lo <= value <= hi


def test_a_folder_is_that_of_the_program(scenario: Path, tmp_path: Path) -> None:
    theirs, mine = tmp_path / "theirs", tmp_path / "mine"
    assert program("run", str(scenario), "--out", str(theirs), "--record", "none", "--quiet").returncode == 0
    ran = locsim.run(scenario, out=mine)
    assert ran.out == mine
    for name in ["steps.csv", "trials.parquet", "models/classic.model", "trajectories/reference.tum"]:
        assert (mine / name).read_bytes() == (theirs / name).read_bytes(), name
    with pytest.raises(locsim.LocsimError) as caught:
        locsim.run(scenario, out=mine)
    printed = program("run", str(scenario), "--out", str(mine), "--record", "none")
    assert printed.stderr.strip().splitlines()[-1] == f"error: {caught.value}"
    locsim.run(scenario, out=mine, force=True)


def test_arrow_goes_to_all_that_read_it(ran: locsim.Run) -> None:
    steps = ran.tables["steps"]
    pyarrow = pytest.importorskip("pyarrow")
    expected = pyarrow.table(steps)
    assert (expected.num_rows, expected.column_names) == (len(steps), steps.column_names)
    # No copy: two tables share the memory of one batch.
    buffers = [pyarrow.table(table).column("truth_x_m").chunk(0).buffers()[1].address for table in [steps, steps]]
    assert buffers[0] == buffers[1]

    polars = pytest.importorskip("polars")
    assert polars.DataFrame(steps).to_arrow().cast(expected.schema).equals(expected)
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame.from_arrow(steps)
    assert pyarrow.Table.from_pandas(frame, preserve_index=False).cast(expected.schema).equals(expected)
    duckdb = pytest.importorskip("duckdb")
    found = duckdb.sql("select model, avg(position_error_m) from steps group by model order by model").fetchall()
    means = expected.group_by("model").aggregate([("position_error_m", "mean")]).sort_by("model").to_pylist()
    assert found == [(row["model"], pytest.approx(row["position_error_m_mean"], rel=1e-12)) for row in means]


def test_threads_change_nothing(scenario: Path, ran: locsim.Run) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    one = locsim.run(scenario, threads=1)
    assert pyarrow.table(one.tables["steps"]).equals(pyarrow.table(ran.tables["steps"]))


def test_a_missed_bound_is_told(scenario: Path) -> None:
    keys = locsim.Scenario(scenario).to_dict()
    keys["expect"] = {"classic": {"position_rmse_m": {"max": 1e-6}}}
    ran = locsim.run(locsim.Scenario(keys, base=scenario.parent), trials=1)
    assert [missed.split(" is ")[0] for missed in ran.missed] == ["classic.position_rmse_m"]


def test_ctrl_c_stops_a_run(scenario: Path) -> None:
    long = locsim.Scenario(scenario, trials=20_000, models=["classic"])

    def interrupt() -> None:
        time.sleep(1.5)
        os.kill(os.getpid(), signal.SIGINT)

    sender = threading.Thread(target=interrupt)
    sender.start()
    with pytest.raises(KeyboardInterrupt):
        locsim.run(long)
    sender.join()


def test_other_threads_go_on_while_a_run_works(scenario: Path) -> None:
    ticks = 0
    done = threading.Event()

    def tick() -> None:
        nonlocal ticks
        while not done.wait(0.001):
            ticks += 1

    ticker = threading.Thread(target=tick)
    ticker.start()
    locsim.run(scenario, models=["classic"])
    done.set()
    ticker.join()
    assert ticks > 10


def test_progress_is_drawn_by_tqdm(scenario: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tqdm")
    locsim.run(scenario, progress=True)
    assert "trials" in capsys.readouterr().err
    locsim.run(scenario)
    assert capsys.readouterr().err == ""
