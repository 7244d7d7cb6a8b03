"""What each command that writes does with what it finds: command x surface, the table of docs/security.md."""

import fcntl
import importlib
import os
import resource
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

import pytest

from polhode.cli.main import main
from polhode.planning.exports.formats import FORMATS
from tests.cli.writing_commands import WRITERS, Stage, make_quick, make_stage
from tests.pipeline.conftest import make_example

Capture = pytest.CaptureFixture[str]
PAGE = Path(__file__).parents[2] / "docs" / "security.md"
NOTES = "the user's notes\n"
REASON = {"read-only": "Read-only file system", "full": "File too large"}

WRITTEN, REPLACED, REFUSED, NONE = "written", "replaced", "refused", "-"
RESUMED, STAYS, FAILED = "resumed", "replaced; theirs stays", "fails; nothing replaced"
STAGED = ("run", "simulate", "import")
"""Those that write beside the place, and then replace it whole."""
FOLDERS = (
    *STAGED[:2],
    *("compare", "sweep", "train", "calibrate", "checkout", "plan", "observability", "import"),
)
FILES = ("export", "export urdf", "predict", "report", "view")
COMMANDS = (*FOLDERS, *FILES)


def read_table() -> dict[str, dict[str, str]]:
    """The table of the page: what ``-o`` finds -> command -> what the command does."""
    section = PAGE.read_text().split("## What each command does with what it finds")[1].split("\n## ")[0]
    section = section[section.index("| what `-o` finds |") :]
    lines = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")]
    head, _, *rows = [[cell.strip() for cell in line] for line in lines]
    # commands that do the same share a column
    columns = [cell.strip("`").split("`, `") for cell in head[1:]]
    assert sorted(name for names in columns for name in names) == sorted(COMMANDS)
    return {
        found: {name: cell for names, cell in zip(columns, cells, strict=True) for name in names}
        for found, *cells in rows
    }


TABLE = read_table()


def test_the_table_has_every_outcome() -> None:
    found = {outcome for cells in TABLE.values() for outcome in cells.values()}
    assert found == {WRITTEN, REPLACED, REFUSED, NONE, RESUMED, STAYS, FAILED}
    assert len(TABLE) == 29


def digest(folder: Path, *without: Path) -> dict[str, str]:
    """What is below a folder: kinds, contents, targets of links."""
    found = {}
    for root, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(root) / name
            if any(path == each or each in path.parents for each in without):
                continue
            mode = path.lstat().st_mode
            if stat.S_ISLNK(mode):
                content = f"link {path.readlink()}"
            elif stat.S_ISREG(mode):
                content = sha256(path.read_bytes()).hexdigest()
            else:
                content = str(stat.S_IFMT(mode))
            found[str(path.relative_to(folder))] = content
    return found


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    return make_stage(tmp_path_factory.mktemp("outputs") / "inputs", make_example())


class Scene:
    """One cell: a command, and a place that a surface has prepared."""

    def __init__(self, name: str, stage: Stage, area: Path, own: Path) -> None:
        self.name, self.stage, self.writer = name, stage, WRITERS[name]
        self.area, self.own = area, own
        self.output = self.place = area / self.writer.target
        """What -o names, and where it leads"""
        self.more: list[str] = []
        self.kept: list[Path] = []
        """Of the user, at the place"""
        self.cleared: list[Path] = []
        """To be removed by the command"""
        self.current: Path | None = None
        """Where the command is called"""
        self.words: list[str] = []
        """The whole command line, if it is another one than usual"""
        self.rival: Path | None = None
        """What another process is writing, which lives"""

    @property
    def beside(self) -> Path | None:
        """The folder that the command writes beside its file."""
        return self.place.with_name(f"{self.place.name}_meshes") if self.writer.beside else None

    def overwrite(self) -> None:
        """Give --overwrite where there is one."""
        self.more = ["--overwrite"] if self.writer.overwrite else []

    def make_own(self, place: Path) -> None:
        """An earlier result of the same command."""
        place.parent.mkdir(parents=True, exist_ok=True)
        source = self.own / self.writer.target
        shutil.copytree(source, place) if self.writer.is_folder else shutil.copy(source, place)
        if self.writer.beside:
            shutil.copytree(self.own / self.writer.beside, place.with_name(f"{place.name}_meshes"))

    def make_foreign(self, place: Path) -> None:
        """Something of the user."""
        if not self.writer.is_folder:
            place.write_text(NOTES)
            return
        (place / "results").mkdir(parents=True)
        (place / "notes.txt").write_text(NOTES)
        (place / "results" / "table.csv").write_text("1,2\n")

    def written(self) -> list[Path]:
        """All that the command may write or replace."""
        return [self.place, *([self.beside] if self.beside else []), *self.cleared]


def call(scene: Scene) -> int:
    return main(scene.words or scene.stage.words(scene.name, scene.output, *scene.more))


def link_from(scene: Scene) -> Path:
    """Let ``-o`` name a link to another place."""
    target = scene.area / "elsewhere" / scene.writer.target
    target.parent.mkdir()
    scene.output.symlink_to(target)
    scene.place = target
    return target


def linked_dataset(scene: Scene) -> None:
    (scene.area / "elsewhere" / "cam0").mkdir(parents=True)
    (scene.area / "rec").mkdir()
    (scene.area / "rec" / "mav0").symlink_to(scene.area / "elsewhere")


def foreign_with_our_names(scene: Scene) -> None:
    if scene.beside:
        scene.beside.mkdir()
        (scene.beside / "surface.obj").write_text(NOTES)
        return
    scene.make_foreign(scene.place)
    shutil.copy(scene.stage.run / "summary.json", scene.place)
    for name in ("report.html", "edges.csv"):
        (scene.place / name).write_text(NOTES)
    (scene.place / "config.yaml").write_text("mine: 1\n")
    shutil.copy(scene.stage.inputs / "scene.yaml", scene.place)
    recording = scene.place / "mav0" / "cam0" / "data"
    recording.mkdir(parents=True)
    (recording / "1.png").write_bytes(b"recorded")
    scene.overwrite()


def own_and_foreign(scene: Scene) -> None:
    folder = scene.beside or scene.place
    (folder / "notes.txt").write_text(NOTES)
    (folder / "mine").mkdir()
    (folder / "mine" / "more.txt").write_text(NOTES)
    (folder / "link").symlink_to(scene.stage.inputs)
    scene.kept = [folder / "notes.txt", folder / "mine" / "more.txt", folder / "link"]


def stale(scene: Scene) -> None:
    """What is left of a process that was killed: its number is that of one that has ended."""
    place, ended = scene.place, subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    if scene.name in STAGED:
        left = place.with_name(f".{place.name}.partial")
        left.mkdir()
        name = {"run": "measurements.npz", "simulate": "scene.yaml", "import": "import.json"}[scene.name]
        (left / name).write_text("half")
    else:
        folder = place.parent
        if scene.writer.is_folder:
            scene.make_own(place)
            folder = place
        file = Path(scene.writer.main_file or place.name)
        left = folder / f".{file.stem}.partial-{ended.pid}{file.suffix}"
        left.write_text("half")
    scene.cleared = [left]


def busy(scene: Scene) -> None:
    if scene.name in ("export", "predict", "report", "view"):
        place = scene.place
        scene.rival = place.with_name(f".{place.stem}.partial-{os.getppid()}{place.suffix}")
        shutil.copy(scene.own / scene.writer.target, scene.rival)
        return
    if scene.name in STAGED:
        folder = scene.place.with_name(f".{scene.place.name}.partial")
        folder.mkdir()
    else:
        scene.make_own(scene.place)
        folder = scene.beside or scene.place
    fcntl.flock(os.open(folder, os.O_RDONLY), fcntl.LOCK_EX)


def prepare(scene: Scene, row: int) -> None:
    """What ``-o`` finds, by the row of the table; the rows that are left out find nothing."""
    place, area, is_folder, target = scene.place, scene.area, scene.writer.is_folder, scene.writer.target
    if row in (4, 6, 7, 8, 9, 13, 18, 19, 26):
        scene.overwrite()
    if row in (5, 6, 7, 8, 26):
        scene.make_own(place)
    match row:
        case 1:
            place.mkdir() if is_folder else place.touch()
        case 2 | 4:
            scene.make_foreign(place)
        case 3:
            foreign_with_our_names(scene)
        case 7:
            own_and_foreign(scene)
        case 8:
            names = {"run": "pushes.csv", "plan": "corridor.csv"}
            name = names.get(scene.name, "u.urdf_meshes/collision_007.obj")
            (area / name if scene.beside else place / name).write_text(NOTES)
        case 9:
            shutil.copytree(scene.stage.run, area / "run")
            (area / "to_run").symlink_to(area / "run")
            folder = {"plan": "pictures", "observability": "pictures/new"}
            scene.output = area / "to_run" / ".." / "run" / folder.get(scene.name, "covariance.npz")
        case 10:
            (area / "rec" / "mav0" / "cam0").mkdir(parents=True)
            scene.output = area / "rec" / "mav0" / target
        case 11:
            linked_dataset(scene)
            (area / "short").symlink_to(Path("rec") / "mav0" / "cam0")
            scene.output = area / "short" / target
        case 12:
            linked_dataset(scene)
            (area / "elsewhere" / "cam0" / "data.csv").write_text("#timestamp [ns],filename\n")
            scene.output = area / "elsewhere" / target
        case 13:
            place.write_text(NOTES) if is_folder else place.mkdir()
        case 14 | 15:
            scene.current = scene.place = area / "here"
            scene.current.mkdir()
            scene.output = Path()
            if row == 15:
                scene.words = scene.stage.words(scene.name, Path("UNSET"))
                scene.words[scene.words.index("UNSET")] = ""
        case 16:
            scene.output, scene.place = area / "a" / "b" / target, area / "a"
        case 17:
            (area / "notes.txt").write_text(NOTES)
            scene.output = area / "notes.txt" / target
        case 18:
            scene.make_own(link_from(scene))
        case 19:
            scene.make_foreign(link_from(scene))
        case 20:
            link_from(scene)
        case 21:
            scene.output.symlink_to(area / "back")
            (area / "back").symlink_to(scene.output)
        case 22:
            scene.output = Path("/dev/null")
        case 23:
            os.mkfifo(scene.output)
        case 27:
            stale(scene)
        case 28:
            busy(scene)


CELLS = [(surface, name) for surface, cells in TABLE.items() for name in COMMANDS if cells[name] != NONE]


@contextmanager
def condition(surface: str, area: Path, patch: pytest.MonkeyPatch) -> Iterator[None]:
    """A place that refuses: read-only, full, or nearly full."""
    if "read-only" in surface:
        _refuse_writing(area, patch)
    limits = {"a place that is full": 0, "a place that fills during the work, its own result there": 4096}
    if surface not in limits:
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits[surface], before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def _refuse_writing(area: Path, patch: pytest.MonkeyPatch) -> None:
    """As a read-only file system does; permissions do not hold back the super-user."""
    for name in ("mkdir", "open"):
        real = getattr(os, name)

        def refuse(
            path: object, flags: int = os.O_RDWR, *more: object, real: object = real, **named: object
        ) -> object:
            at = str(Path(os.fsdecode(path)).resolve()) if isinstance(path, str | os.PathLike) else ""
            if at.startswith(str(area)) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                raise OSError(30, "Read-only file system", at)
            return real(path, flags, *more, **named)  # type: ignore[operator]

        patch.setattr(os, name, refuse)


@pytest.fixture(scope="module")
def own_results(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A folder with an earlier result of each command."""
    folder, made = tmp_path_factory.mktemp("own"), set()

    def result(name: str) -> Path:
        at = folder / name.replace(" ", "_")
        if name not in made:
            at.mkdir()
            assert stage.call(name, at / WRITERS[name].target) == 0
            made.add(name)
        return at

    return result


@pytest.mark.parametrize(("surface", "name"), CELLS, ids=[f"{name}: {surface}" for surface, name in CELLS])
def test_cell(
    surface: str,
    name: str,
    stage: Stage,
    own_results: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    make_quick(monkeypatch, stage)
    scene = Scene(name, stage, tmp_path / "area", own_results(name))
    scene.area.mkdir()
    prepare(scene, list(TABLE).index(surface))
    monkeypatch.chdir(scene.current or Path.cwd())
    expected, inputs = TABLE[surface][name], digest(stage.inputs)
    capsys.readouterr()
    may_write = scene.written() if expected not in (REFUSED, FAILED) else []
    if expected == FAILED and name in STAGED:
        # what was found, rendered or imported is not lost either
        ending = {"run": "R.failed", "simulate": ".S.partial", "import": ".I.partial"}[name]
        may_write = [scene.place.with_name(ending), scene.place.with_name(".R.partial")]
    before = digest(scene.area, *may_write)
    main_file = (scene.current or Path()) / scene.output / scene.writer.main_file
    earlier = main_file.stat().st_ino if main_file.is_file() else None
    with condition(surface, scene.area, monkeypatch):
        code = call(scene)
    monkeypatch.undo()
    printed = capsys.readouterr()
    assert digest(stage.inputs) == inputs
    assert digest(scene.area, *may_write) == before
    if expected in (REFUSED, FAILED):
        assert code == (2 if expected == REFUSED else 1), printed.err
        assert printed.err.startswith("polhode: error: ") and printed.err.count("\n") == 1
        assert "defect" not in printed.err
        return
    assert (code, printed.err) == (0, "")
    assert main_file.is_file() and main_file.stat().st_size > 0
    assert main_file.stat().st_ino != earlier
    for path in scene.kept:
        assert path.is_symlink() or path.read_text() == NOTES
    for path in scene.cleared:
        assert not path.exists()
        assert name not in STAGED or f"{path}: left by a command" in printed.out
    hidden = list(scene.area.rglob(".*partial*")) + list(scene.area.rglob(".*.old"))
    assert hidden == ([] if scene.rival is None else [scene.rival])
    if scene.rival is not None:
        # the other one ends, and is replaced in turn
        scene.rival.replace(scene.place)
        make_quick(monkeypatch, stage)
        assert call(scene) == 0


WORK = {
    "plan": "polhode.planning.plan.plan_run",
    "observability": "polhode.planning.observability.assess.assess",
    "export urdf": "polhode.planning.exports.export_run.open_job",
}


@pytest.mark.parametrize("name", WORK)
def test_a_second_process_cannot_begin_in_a_folder_until_the_first_has_ended(
    name: str, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    make_quick(monkeypatch, stage)
    place, codes = tmp_path / "a" / WRITERS[name].target, []
    module, _, function = WORK[name].rpartition(".")
    work = getattr(importlib.import_module(module), function)

    def meanwhile(*words: object) -> object:
        monkeypatch.setattr(WORK[name], work)
        codes.append(stage.call(name, place))
        return work(*words)

    monkeypatch.setattr(WORK[name], meanwhile)
    assert stage.call(name, place) == 0 and codes == [2]
    refused("another polhode is at work there", capsys)
    before = digest(tmp_path)
    assert stage.call(name, place) == 0
    assert digest(tmp_path).keys() == before.keys()
    monkeypatch.undo()
    # a call that fails leaves no folder that it made
    assert main([*stage.words(name, tmp_path / "new" / "R"), "--horizon", "-1", "--sun", "0", "0", "0"]) == 2
    assert not (tmp_path / "new").exists()


def refused(line: str, capsys: Capture) -> None:
    """One line with these words, and nothing else on standard error."""
    stderr = capsys.readouterr().err
    assert line in stderr and stderr.count("\n") == 1, stderr


def test_a_copy_of_a_runs_result_is_no_prediction_page_or_export(
    stage: Stage, tmp_path: Path, capsys: Capture
) -> None:
    run = str(stage.run)
    for name, words in {
        "trajectory.csv": ["predict", run, "--horizon", "5"],
        "covariance.npz": ["predict", run, "--horizon", "5"],
        "mesh.ply": ["export", run, "--to", "ply"],
        "mesh.glb": ["export", run, "--to", "glb"],
        "summary.json": ["export", run, "--to", "json"],
    }.items():
        copy = Path(shutil.copy(stage.run / name, tmp_path / f"my_{name}"))
        stays([*words, "-o", str(copy)], copy, capsys)


def stays(words: list[str], file: Path, capsys: Capture) -> None:
    """The command refuses to replace the file."""
    before = file.read_bytes()
    capsys.readouterr()
    assert main(words) == 2
    refused("so it stays; choose another -o", capsys)
    assert file.read_bytes() == before


MENTIONS = (
    "#!/bin/sh\n# my notes\npolhode export D --to stl -o t.stl\n",
    "polhode export of the run D: to be done on Monday\n",
    "# polhode export of the run D\n\nto be done on Monday\n",
    '{"notes": "polhode-export/1"}\n',
    '{\n "schema": "polhode-export/1"\n}\n',
)


@pytest.mark.parametrize("to", [*FORMATS])
def test_every_export_knows_its_own_files(to: str, stage: Stage, tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / f"target.{to}"
    words = ["export", str(stage.run), "--to", to, "--pieces", "1", "--horizon", "2", "-o", str(file)]
    assert main(words) == main(words) == 0
    # the same text further down, or a mention of exports, makes a file of the user
    for content in (b"# mine\n" + file.read_bytes(), *(each.encode() for each in MENTIONS)):
        file.write_bytes(content)
        stays(words, file, capsys)
    if to == "stl":  # of an earlier version
        file.write_bytes(b"binary STL; frame cad, mm".ljust(80) + bytes(4))
        assert main(words) == 0 and file.stat().st_size > 84


def test_a_table_of_the_same_columns_is_no_prediction(stage: Stage, tmp_path: Path, capsys: Capture) -> None:
    """Ours are known whatever their run and step."""
    for name in ("mine.npz", "mine.csv"):
        file = tmp_path / name
        for more in ("9 --step-s 3 --marks", "0.5", "100 --step-s 30", "1 --step-s 0.3333333337", "3"):
            words = ["predict", str(stage.run), "-o", str(file), "--horizon", *more.split()]
            assert main(words) == 0
    header, *rows = file.read_text().splitlines()
    own = (stage.run / "trajectory.csv").read_text().splitlines()[1:]

    def moved(row: str) -> str:
        stamp, x, *more = row.split(",")
        return ",".join([stamp, repr(float(x) + 0.01), *more])

    for changed in (
        [moved(rows[2])],
        [",".join(["17", *rows[2].split(",")[1:]])],
        [own[3]],
        own[3:],
        [*rows[:2], moved(rows[2]), *rows[3:]],
        [*rows[:2], *rows[3:]],
        [rows[0].replace(",", ", "), *rows[1:]],
        ["# mine", *rows],
    ):
        file.write_text("\n".join([header, *changed]) + "\n")
        stays(words, file, capsys)


def test_the_report_of_a_run_is_renewed_by_that_run_alone(
    stage: Stage, tmp_path: Path, capsys: Capture
) -> None:
    run, other = tmp_path / "run", tmp_path / "other"
    for folder in (run, other):
        shutil.copytree(stage.run, folder)
        # as an earlier version wrote it
        (folder / "report.html").write_text("<html>")
    (tmp_path / "link").symlink_to(run)
    assert main(["report", str(run), "-o", str(tmp_path / "link" / "report.html")]) == 0
    assert len((run / "report.html").read_text()) > 1000
    for runs in ([run], [run, other]):
        assert main(["report", *map(str, runs), "-o", str(other / "report.html")]) == 2
        refused("belongs to the results of the run", capsys)
    assert (other / "report.html").read_text() == "<html>"
    for again in (str(run), f"{run}/.", str(tmp_path / "link")):
        assert main(["report", str(run), again, "-o", str(tmp_path / "page.html")]) == 2
        refused("are the same run: give each run once", capsys)
    assert not (tmp_path / "page.html").exists()


def test_a_folder_above_the_current_one_is_not_replaced(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    make_quick(monkeypatch, stage)
    assert stage.call("run", tmp_path / "R") == 0
    (tmp_path / "R" / "mine").mkdir()
    monkeypatch.chdir(tmp_path / "R" / "mine")
    before = digest(tmp_path)
    assert stage.call("run", Path(".."), "--overwrite") == 2
    refused(".. contains the current folder", capsys)
    assert digest(tmp_path) == before


@pytest.mark.parametrize("what", ["read-only", "full", "metrics.json", "report.html"])
def test_evaluate_into_a_run_that_cannot_be_written(
    what: str, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    run = tmp_path / "run"
    shutil.copytree(stage.run, run)
    is_folder = what not in REASON
    if is_folder:  # in the place of the file
        (run / what).unlink(missing_ok=True)
        (run / what).mkdir()
    monkeypatch.setattr("polhode.report.page.evaluate", lambda run, data: {})
    before = digest(tmp_path)
    with condition("a place that is full" if what == "full" else what, tmp_path, monkeypatch):
        assert main(["evaluate", str(run), str(tmp_path)]) == (1 if is_folder else 2)
    monkeypatch.undo()
    remedy = "; make the run writable, or evaluate a copy of it" if what == "read-only" else ""
    refused("cannot be written" if is_folder else f"cannot write here ({REASON[what]}){remedy}", capsys)
    assert digest(tmp_path) == before


NOT_UTF8 = os.fsdecode(b"bad\xff")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_name_that_is_not_utf8_is_refused_at_once(
    name: str, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    make_quick(monkeypatch, stage)
    (tmp_path / "link").symlink_to(tmp_path / NOT_UTF8)
    for output in (tmp_path / NOT_UTF8, tmp_path / "link"):
        assert stage.call(name, output) == 2
        refused("this name is not UTF-8", capsys)
    assert [each.name for each in tmp_path.iterdir()] == ["link"]


def test_a_run_whose_name_is_not_utf8_is_shown_with_escapes(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, shown, page = tmp_path / NOT_UTF8, "bad\\udcff", tmp_path / "page.html"
    shutil.copytree(stage.run, run)
    monkeypatch.setattr("polhode.report.page.evaluate", lambda run, data: {"rmse_position_m": 1.0})
    assert main(["evaluate", str(run), str(tmp_path)]) == 0
    assert f"<title>{shown}" in (run / "report.html").read_text()
    killed = tmp_path / "killed"
    shutil.copytree(stage.run, killed)
    (killed / ".report.partial-999999999.html").write_text("half")
    assert main(["evaluate", str(killed), str(tmp_path)]) == 0
    assert not list(killed.glob(".report*")), "what a killed evaluation left is removed"
    for runs in ([run], [run, stage.run]):
        assert main(["report", *map(str, runs), "-o", str(page)]) == 0
        assert shown in page.read_text()
    for to in FORMATS:
        file = str(tmp_path / f"target.{to}")
        words = ["export", str(run), "--to", to, "--pieces", "1", "--horizon", "2", "-o", file]
        assert main(words) == main(words) == 0
    assert f"the run {shown} " in (tmp_path / "target.urdf").read_text()
