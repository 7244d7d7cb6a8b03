"""The time that a whole run still takes: from the shares of the stages, corrected by what has passed."""

from pathlib import Path

import pytest

from polhode.cli.console import Lines, duration
from polhode.cli.time_left import (
    RUN_SHARES,
    StageShare,
    TimeLeft,
    main,
    mean_shares,
    shares_of_log,
)

SHARES = (StageShare("first", 0.1, 0.4), StageShare("again", 0.4, 0.5), StageShare("again", 0.6, 0.8))
LOG = """\
2026-01-01 00:00:10,000 NOTE polhode.compiled: some functions are compiled now
2026-01-01 00:00:20,000 INFO polhode.cli.console: first (rootsift): 5.0 s
2026-01-01 00:00:20,000 INFO polhode.pipeline.x: first: 7.0 s
2026-01-01 00:00:30,000 INFO polhode.cli.console: again: 10.0 s
a line of a traceback
2026-01-01 00:00:50,000 INFO polhode.pipeline.x: the end
"""


class Clock:
    """A clock that a test sets."""

    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def test_it_is_right_when_the_shares_are() -> None:
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    assert left.seconds() is None
    clock.seconds = 10.0
    left.begin("first (rootsift)")
    clock.seconds = 25.0
    left.advance(0.5)
    assert left.seconds() == pytest.approx(75.0)
    # between steps it goes down by itself
    clock.seconds = 30.0
    assert left.seconds() == pytest.approx(70.0)
    clock.seconds = 40.0
    left.advance(1.0)
    assert left.seconds() == pytest.approx(60.0)
    assert left.share == pytest.approx(0.4)


def test_a_slow_machine_is_noticed_and_a_stage_that_hangs_leaves_what_follows_it() -> None:
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    left.begin("first")
    clock.seconds = 60.0
    left.advance(1.0)
    # three tenths of the whole took a minute, six are left
    assert left.seconds() == pytest.approx(120.0)
    left.begin("again")
    clock.seconds = 1000.0
    # the stage was to end at half of the whole
    assert left.seconds() == pytest.approx(120.0 * 0.5 / 0.6)
    left.advance(1.0)
    clock.seconds = 5000.0
    # the next one was to begin a tenth of the whole later
    assert left.seconds() == pytest.approx((1000.0 / 0.4 * 0.5) * 0.4 / 0.5)


def test_a_stage_that_comes_back_has_its_own_share_and_an_unknown_one_changes_nothing() -> None:
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    left.begin("again")
    left.advance(1.0)
    assert left.share == pytest.approx(0.5)
    left.begin("something else")
    left.advance(1.0)
    assert left.share == pytest.approx(0.5)
    for _ in range(2):
        left.begin("again")
        left.advance(1.0)
        assert left.share == pytest.approx(0.8)


def test_a_resumed_run_counts_from_the_first_stage_that_it_does() -> None:
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    left.begin("again")
    clock.seconds = 10.0
    left.advance(1.0)
    # a tenth of the whole took ten seconds
    assert left.seconds() == pytest.approx(50.0)


def test_the_lines_of_a_run_say_what_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    progress = Lines(TimeLeft(SHARES, clock))
    with progress.stage("first", 2) as advance:
        clock.seconds = 30.0
        advance()
        advance()
    assert capsys.readouterr().out.endswith("s; about 60 s left\n")
    assert duration(99.0) == "99 s" and duration(150.0) == "2 min"


def test_the_shares_of_a_run_are_those_of_its_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert shares_of_log(LOG) == [
        StageShare("first", 0.125, 0.25),
        StageShare("again", 0.25, 0.5),
    ]
    assert mean_shares([SHARES, SHARES[:1]]) == [SHARES[0]]
    (tmp_path / "log.txt").write_text(LOG)
    assert main([str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[1] == '    StageShare("again", 0.25, 0.50),'
    (tmp_path / "log.txt").write_text("nothing\n")
    assert main([str(tmp_path)]) == 2 and main([]) == 2 and main([str(tmp_path / "none")]) == 2


def test_the_table_goes_forward_and_its_stages_are_those_of_the_program() -> None:
    times = [time for share in RUN_SHARES for time in (share.begins, share.ends)]
    assert times == sorted(times) and times[0] >= 0.0 and times[-1] == 1.0
    root = Path(__file__).parents[2]
    code = "".join(
        path.read_text()
        for room in ("pipeline", "backend", "mapping")
        for path in (root / room).rglob("*.py")
    )
    for share in RUN_SHARES:
        assert f'stage("{share.title}' in code or f'stage(f"{share.title}' in code
