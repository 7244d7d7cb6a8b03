"""The commands that are killed, or whose disk is full: their words, their results, and who reads these.

In the words, {stage} is the folder of the inputs, {place} that of the case.
"""

from dataclasses import dataclass

Words = tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """One command line."""

    name: str
    words: Words
    results: tuple[str, ...]
    """Names in the folder of the case that the command makes"""
    before: Words = ()
    """Makes an earlier good result, of other settings"""
    inputs: tuple[str, ...] = ()
    """Names of the stage that are copied into the folder of the case first"""
    later: tuple[Words, ...] = ()
    """Commands that read the result"""
    overwrite: bool = False
    """Whether the command is repeated with --overwrite: it refuses a result that is there"""
    continues: tuple[str, ...] = ()
    """Hidden folders beside the result in which the same command goes on"""
    resumes: bool = False
    """Whether an unfinished result is visible, and the same command goes on with it"""

    def reads(self, name: str) -> bool:
        """Whether the command, or one before or after it, needs this input of the stage."""
        every = (*self.words, *self.before, *(word for words in self.later for word in words))
        place = f"{{stage}}/{name}"
        return name in self.inputs or any(word == place or word.startswith(f"{place}/") for word in every)

    @property
    def repeated(self) -> Words:
        """The words that repeat the command, whatever is there."""
        return (*self.words, "--overwrite") if self.overwrite else self.words


_RUN = ("run", "--data", "{stage}/S", "-o", "{place}/R", "--runtime.workers", "2")
_SIMULATE = ("simulate", "{stage}/scene.yaml", "-o", "{place}/S")
_TRAIN = (
    *("train", "{stage}/train.yaml", "--train.output", "{place}/T"),
    *("--train.corpus.folder", "{place}/corpus"),
)
_PLAN = ("plan", "{stage}/R", "-o", "{place}/P", "--horizon", "10")
_READERS = (("predict", "{place}/R", "--horizon", "5"), ("report", "{place}/R", "-o", "{stage}/later.html"))
_CALIBRATE = (
    *("calibrate", "--left", "{stage}/boards/left", "--right", "{stage}/boards/right"),
    *("--board", "7x5", "--square-mm", "30", "-o", "{place}/B"),
)
_VERIFY = (*_CALIBRATE[:-1], "{place}_later", "--verify", "{place}/B")
_CHECKOUT = ("checkout", "{stage}/S", "-o", "{place}/C")
_IMPORT = ("import", "{stage}/S", "-o", "{place}/I")
_CHECKED = (("checkout", "{place}/I", "-o", "{place}_later"),)

JOBS = {
    job.name: job
    for job in (
        Job("run", _RUN, ("R",), later=_READERS, overwrite=True),
        Job("run --overwrite", (*_RUN, "--overwrite"), ("R",), (*_RUN, "--seed", "7"), later=_READERS),
        Job("simulate", _SIMULATE, ("S",), overwrite=True, continues=(".S.partial",)),
        Job("simulate --overwrite", (*_SIMULATE, "--overwrite"), ("S",), (*_SIMULATE, "--seed", "7"),
            continues=(".S.partial",)),
        Job("compare", ("compare", "{stage}/compare.yaml", "--run", "{stage}/R", "-o", "{place}/D"), ("D",),
            resumes=True),
        Job("train", _TRAIN, ("T", "corpus"), inputs=("corpus",), resumes=True),
        Job("plan", (*_PLAN, "--confidence", "0.95"), ("P",), (*_PLAN, "--confidence", "0.9")),
        Job("export", ("export", "{stage}/R", "--to", "urdf", "-o", "{place}/u.urdf", "--pieces", "2"),
            ("u.urdf", "u.urdf_meshes"),
            ("export", "{stage}/R", "--to", "urdf", "-o", "{place}/u.urdf", "--pieces", "1")),
        Job("report", ("report", "{stage}/R", "-o", "{place}/page.html"), ("page.html",),
            ("report", "{stage}/R", "{stage}/R", "-o", "{place}/page.html")),
        Job("evaluate", ("evaluate", "{place}/R", "{stage}/S"), ("R",), inputs=("R",),
            later=(("report", "{place}/R", "-o", "{stage}/later.html"),)),
        Job("observability", ("observability", "{stage}/R", "-o", "{place}/O"), ("O",),
            ("observability", "{stage}/R", "-o", "{place}/O", "--sigma-px", "2")),
        Job("predict", ("predict", "{stage}/R", "--horizon", "5", "-o", "{place}/p.csv"), ("p.csv",),
            ("predict", "{stage}/R", "--horizon", "3", "-o", "{place}/p.csv")),
        Job("calibrate", _CALIBRATE, ("B",), (*_CALIBRATE, "--model", "brown8"), later=(_VERIFY,)),
        Job("checkout", _CHECKOUT, ("C",), (*_CHECKOUT, "--rig", "{stage}/S/mav0")),
        Job("import", _IMPORT, ("I",), later=_CHECKED, overwrite=True, continues=(".I.partial",)),
        Job("import --overwrite", (*_IMPORT, "--crop", "4,4,192,152", "--overwrite"), ("I",),
            (*_IMPORT, "--every", "2"), later=_CHECKED, continues=(".I.partial",)),
    )
}  # fmt: skip
