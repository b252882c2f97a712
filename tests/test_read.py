"""Results of other tools: read whole, or refused in one line; and what the statistics make of them."""

import json
import struct

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from refusals import refused

import jaxrl_tab as rl
from jaxrl_tab.cli import main
from jaxrl_tab.core import events

STEPS, SEEDS = 10, 8


def score(method, seed, step):
    """By hand: rises by 1 a step; methods and seeds are apart by constants, which the statistics must find again."""
    return step / 100 + seed**2 + {"sarsa": 0.0, "dqn": 2.5}[method]


def table(seeds=SEEDS, steps=STEPS):
    rows = [
        (method, seed, 100 * (i + 1), score(method, seed, 100 * (i + 1)))
        for method in ("sarsa", "dqn")
        for seed in range(seeds)
        for i in range(steps)
    ]
    return pd.DataFrame(rows, columns=["method", "seed", "step", "score"])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("read") / "results.csv"
    table().sample(frac=1, random_state=0).to_csv(path, index=False)  # in any order
    return path


def test_a_table_is_read_whole_and_its_statistics_are_those_worked_out_by_hand(file):
    """The last tenth of ten rows is the last one: a run scores 10 + seed^2. Broken once: without `returns` summed."""
    found = rl.read(file)
    assert sorted(found) == ["dqn", "sarsa"] and not found.notes
    ds = found["sarsa"]
    assert ds.returns.dims == ("seed", "row") and ds.sizes == {"seed": SEEDS, "row": STEPS}
    assert (ds.attrs["num_steps"], ds.attrs["log_every"]) == (1000, 100)
    assert ds.returns.sel(seed=3).values.tolist() == [9.0 + i for i in range(1, 11)]
    assert rl.stats.score(ds).values.tolist() == [10.0 + s * s for s in range(SEEDS)]
    assert rl.stats.learning_curve(ds).mean("seed").values.tolist() == [17.5 + i for i in range(1, 11)]
    difference = rl.stats.differences(found)["sarsa"]
    assert difference.interval.estimate == -2.5
    summary = rl.stats.summary(found).set_index("method")
    assert summary.last_tenth_return.to_dict() == {"sarsa": 27.5, "dqn": 30.0}
    assert "optimum" not in summary and "episodes" not in summary and "first_episode_steps" not in summary


def test_parquet_netcdf_a_file_for_each_run_and_what_we_saved_are_the_same(file, tmp_path):
    found, frame = rl.read(file), table()
    frame.to_parquet(tmp_path / "x.parquet")
    frame.set_index(["method", "seed", "step"]).to_xarray().to_netcdf(tmp_path / "theirs.nc")
    for method, seed in ((m, s) for m in ("sarsa", "dqn") for s in range(SEEDS)):
        rows = frame[(frame.method == method) & (frame.seed == seed)]
        lines = pd.DataFrame({"t": rows.step, "r": rows.score}).to_csv(index=False)
        (tmp_path / f"{method}-{seed}.csv").write_text("#{a comment}\n" + lines)
    (tmp_path / "dqn-best.csv").write_text("t,r\n1,2\n")
    rl.export.save(found, tmp_path / "ours.nc")
    by_pattern = rl.read(str(tmp_path / "{method}-{seed}.csv"), step="t", score="r")
    assert len(by_pattern.notes) == 1 and "dqn-best.csv" in by_pattern.notes[0]
    for other in (
        rl.read(tmp_path / "x.parquet"),
        rl.read(tmp_path / "theirs.nc"),
        rl.read(tmp_path / "ours.nc"),
        by_pattern,
    ):
        for name, ds in found.items():
            xr.testing.assert_equal(other[name], ds)
    assert rl.export.to_pandas(found, per="seed").last_tenth_return.sum() == 27.5 * 8 + 30 * 8


def test_settings_environments_and_tables_without_steps(tmp_path):
    rows = [
        (env, "a", lr, seed, bonus + lr * 10 + seed)
        for env, bonus in (("one", 0), ("two/x", 5))
        for lr in (0.1, 0.5)
        for seed in range(3)
    ]
    frame = pd.DataFrame(rows, columns=["task", "method", "lr", "seed", "score"])
    frame["clip"] = 0.2
    frame.to_csv(tmp_path / "x.csv", index=False)
    read = lambda **more: rl.read(tmp_path / "x.csv", environment="task", **more)
    found = read(settings=["lr", "clip"])
    assert list(found) == ["one/a", "two-x/a"]
    assert rl.stats.best(found["one/a"]) == {"lr": 0.5} and rl.stats.fixed(found["one/a"]) == {"clip": 0.2}
    assert rl.stats.score(found["two-x/a"]).sel(lr=0.5).values.tolist() == [10.0, 11.0, 12.0]
    names = ("first_tenth_return", "interim_return", "last_tenth_return")
    assert [name in rl.stats.summary(found.methods["one"]) for name in names] == [False, False, True]
    assert list(rl.plot.pictures(found.methods["one"])) == ["sensitivity"]
    refused(
        read, "a in one, seed 0 is there twice", "x.csv, row 1,", "x.csv, row 4", "hyperparameters: lr, clip"
    )
    frame[1:].to_csv(tmp_path / "x.csv", index=False)
    refused(lambda: read(settings=["lr"]), "there is no run of a in one, lr 0.1, seed 0")


def test_what_cannot_be_read_is_one_line_that_says_where(file, tmp_path):
    """Broken once: without the check of doubles -> a score of twice the size, in silence."""
    path = tmp_path / "x.csv"

    def of(frame, *words, **how):
        frame.to_csv(path, index=False)
        refused(lambda: rl.read(path, **how), *words)

    frame = table()
    renamed = frame.rename(columns={"score": "ep_return"})
    of(renamed, "x.csv has no column 'score': there are method, seed, step, ep_return; score= (--score)")
    of(frame, "no column 'lr'", settings=["lr"])
    of(frame.assign(method="x"), "has a column 'method' already", given={"method": "dqn"})
    texts = frame.astype(object)
    texts.loc[6, "score"] = "abc"
    of(texts, "x.csv, row 7: score is 'abc', not a finite number; 1 such in all")
    texts.loc[6, "score"] = ""
    of(texts, "x.csv, row 7: score is empty")
    texts.loc[6, "score"] = np.inf
    of(texts, "row 7: score is 'inf'")
    texts = frame.astype(object)
    texts.loc[2, "seed"] = 1.5
    of(texts, "row 3: seed must be a whole number of at least 0, not '1.5'")
    of(pd.concat([frame, frame[4:5]]), "sarsa, seed 0, step 500 is there twice: ", "row 5, and", "row 161")
    of(
        frame.drop(index=13),
        "sarsa, seed 1 has no score at step 400, and others have: nothing is interpolated",
    )
    of(frame.drop(index=19), "sarsa, seed 1 has no score at step 1000", "until=")
    of(frame[frame.seed < np.where(frame.method == "dqn", 6, 8)], "sarsa alone has 6, 7", "unpaired=True")
    of(
        frame[(frame.method == "dqn") | (frame.step < 900)],
        "ends at step 800 and dqn at step 1000: until=800",
    )
    of(frame.assign(step=frame.step**2), "steps are not evenly spaced (10000, 40000", "every=")
    of(frame.assign(step=frame.step + frame.seed), "runs have scores at other steps", "every=")
    of(frame[:0], "x.csv has no rows")
    of(frame, "'step' cannot be a hyperparameter", settings=["step"])
    of(frame.assign(step=frame.step * 10**12), "would have 10000000000000 rows", every=100)
    of(frame.assign(method=frame.method.replace("dqn", "")), "row 81: method is empty; 80 such in all")
    random = frame.assign(lr=np.arange(len(frame)), eps=np.arange(len(frame)))
    of(random, "sarsa has 80 scores, fewer than 80 x 80 x 8 values of lr, eps, seed", settings=["lr", "eps"])
    path.write_text("method,seed,score\na,0,1,7\na,1,2,7\n")
    refused(lambda: rl.read(path), "x.csv cannot be read", "does not match")
    damaged = rl.read(file)["dqn"].drop_vars("returns")
    rl.export.save({"dqn": damaged}, tmp_path / "ours.nc")
    refused(lambda: rl.read(tmp_path / "ours.nc"), "dqn is not what a sweep writes")
    path.write_bytes(b"")
    refused(lambda: rl.read(path), "x.csv cannot be read")
    for name in ("x.parquet", "x.nc"):
        (tmp_path / name).write_bytes(b"nothing")
        refused(lambda name=name: rl.read(tmp_path / name), f"{name} cannot be read")
    refused(lambda: rl.read(tmp_path / "no.csv"), "there is no file")
    refused(lambda: rl.read(str(tmp_path / "{method}.tsv")), "no file fits the pattern")
    refused(lambda: rl.read(tmp_path), "there is no event file in the folder")
    refused(lambda: rl.read(__file__), "test_read.py is none of the files that can be read")
    refused(lambda: rl.read(3), "read takes a file, a pattern")


def test_what_was_asked_for_is_left_out_and_told_and_other_steps_are_collected(file, tmp_path):
    frame = table()
    zero = frame[frame.step == 100].assign(step=0, score=-1e9)
    pd.concat([zero, frame]).to_csv(tmp_path / "x.csv", index=False)
    found = rl.read(tmp_path / "x.csv", until=800)
    assert found["dqn"].attrs["num_steps"] == 800 and len(found.notes) == 2
    assert found.notes[0].startswith("16 scores at step 0") and found.notes[1].startswith(
        "32 scores after step 800"
    )
    frame[frame.seed < np.where(frame.method == "dqn", 6, 8)].to_csv(tmp_path / "x.csv", index=False)
    assert "stats.unpaired_difference" in rl.read(tmp_path / "x.csv", unpaired=True).notes[0]
    # Episodes end when they end: all but one of seed 0 in 1..100, in 2 rows of 50; step 50 belongs to the first.
    ends = [(0, 10, 1.0), (0, 50, 2.0), (0, 51, 4.0), (0, 100, 8.0), (1, 99, 16.0)]
    pd.DataFrame(ends, columns=["seed", "step", "score"]).to_csv(tmp_path / "x.csv", index=False)
    ds = rl.read(tmp_path / "x.csv", given={"method": "a"}, every=50)["a"]
    assert ds.episodes.values.tolist() == [[2, 2], [0, 1]] and ds.returns.values.tolist() == [
        [3, 12],
        [0, 16],
    ]
    assert rl.stats.score(ds).values.tolist() == [6.0, 16.0]
    ends[-1] = (1, 49, 16.0)
    pd.DataFrame(ends, columns=["seed", "step", "score"]).to_csv(tmp_path / "x.csv", index=False)
    refused(
        lambda: rl.read(tmp_path / "x.csv", given={"method": "a"}, every=50),
        "a, seed 1 has no score in the last",
    )


def test_compare_takes_them_and_finds_what_is_worse(file, tmp_path):
    worse = table()
    worse["score"] -= np.where(worse.method == "dqn", 5.0, 0.0)
    worse.to_csv(tmp_path / "worse.csv", index=False)
    (beside,) = rl.compare(file, rl.read(tmp_path / "worse.csv")).others
    found = {row.name: (row.verdict, row.difference) for row in beside.rows}
    assert found == {"results/sarsa": ("same", 0.0), "results/dqn": ("worse", -5.0)}


def test_the_command_prints_tables_and_writes_a_page_and_a_file(file, tmp_path, capsys):
    page, saved = tmp_path / "x.html", tmp_path / "x.nc"
    assert main(["read", str(file), "--html", str(page), "--save", str(saved)]) == 0
    out = capsys.readouterr().out
    assert "8 seeds, 1000 steps each" in out and "optimum" not in out and "Speed" not in out
    assert "sarsa less dqn, seed by seed: -2.5" in out.replace("−", "-")
    html = page.read_text()
    assert (
        "Sarsa and dqn in results" in html.replace("dqn and Sarsa", "Sarsa and dqn")
        and "data:image/png" in html
    )
    assert main(["compare", str(file), str(saved), "--fail-if-worse"]) == 0
    capsys.readouterr()
    assert main(["read", str(file), "--json"]) == 0
    means = {
        x["method"]: x["last_tenth_return"]
        for x in json.loads(capsys.readouterr().out)["environments"]["results"]
    }
    assert means == {"sarsa": 27.5, "dqn": 30.0}
    for words, said in (
        (["read"], "name a file of results"),
        (["read", str(file), "--given", "x"], "--given takes COLUMN=VALUE"),
        (["read", str(file), "--html", str(page)], "exists already"),
        (["read", str(file), "--scor", "x"], "did you mean '--score'"),
    ):
        assert main(words) == 2
        assert said in capsys.readouterr().err


# --- event files -------------------------------------------------------------------------------------
def field(number, kind, content):
    length = bytes([len(content)]) if kind == 2 else b""
    return bytes([number << 3 | kind]) + length + content


def record(step, tag, number):
    """A record as TensorFlow writes it, put together here by the specification; `number`: bytes of its field."""
    summary = field(1, 2, field(1, 2, tag.encode()) + number)
    steps = bytes([step & 127 | 128, step >> 7]) if step else b"\0"
    data = field(1, 1, struct.pack("<d", 1e9)) + bytes([2 << 3]) + steps + field(5, 2, summary)
    masked = lambda x: struct.pack("<I", ((crc(x) >> 15 | crc(x) << 17) + 0xA282EAD8) % 2**32)
    length = struct.pack("<Q", len(data))
    return length + masked(length) + data + masked(data)


def crc(data):
    """CRC-32C bit by bit, as its definition has it."""
    x = 0xFFFFFFFF
    for byte in data:
        x ^= byte
        for _ in range(8):
            x = x >> 1 ^ 0x82F63B78 * (x & 1)
    return x ^ 0xFFFFFFFF


def simple(x):
    return field(2, 5, struct.pack("<f", x))


def test_the_checksum_is_that_of_the_standard():
    assert events.crc32c(b"123456789") == 0xE3069283
    assert events.crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, B.4


def test_event_files_are_read_and_a_damaged_tail_is_told_and_not_trusted(tmp_path):
    """Broken once: without the checksum of the data -> the flipped number is taken."""
    for method, seed in ((m, s) for m in ("a", "b") for s in (0, 1)):
        tensor = field(
            8, 2, field(1, 0, b"\1") + field(2, 2, b"") + field(5, 2, struct.pack("<f", seed + 2.0))
        )
        (tmp_path / f"{method}_{seed}").mkdir()
        (tmp_path / f"{method}_{seed}" / "events.out.tfevents.1.x").write_bytes(
            record(100, "loss", simple(9))
            + record(100, "eval/r", simple(seed + 1.0))
            + record(200, "eval/r", tensor)
        )
    pattern = str(tmp_path / "{method}_{seed}")
    found = rl.read(pattern, score="eval/r")
    assert not found.notes
    assert found["b"].returns.values.tolist() == [[1.0, 2.0], [2.0, 3.0]]
    refused(lambda: rl.read(pattern, score="eval/R"), "has no scalar 'eval/R': there are loss, eval/r")
    file = tmp_path / "a_1" / "events.out.tfevents.1.x"
    whole = file.read_bytes()
    more = record(300, "eval/r", simple(7.0))
    flipped = [bytes(x ^ (i == place) for i, x in enumerate(more)) for place in (8, len(more) - 6)]
    tags = events.scalars(file).tags
    for place in range(len(more)):
        file.write_bytes(whole + bytes(x ^ 4 * (i == place) for i, x in enumerate(more)))
        assert events.scalars(file) == (tags, len(whole))
    for tail in (*flipped, more[:-3], b"\0", b"\xff" * 40):
        file.write_bytes(whole + tail)
        found = rl.read(pattern, score="eval/r")
        assert f"damaged or cut off from byte {len(whole)} on" in found.notes[0]
        assert found["a"].returns.values.tolist() == [[1.0, 2.0], [2.0, 3.0]]
