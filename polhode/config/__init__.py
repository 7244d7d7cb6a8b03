"""The configuration: the only place where defaults live (docs/command_line.md#configuration).

In: YAML files and overrides of the command line. Out: a frozen ``Config``.

- backend_settings, frontend_settings, mapping_settings, scene_settings, compare_settings, train_settings: the
  settings, with defaults, units and descriptions
- loader: reading files, ``extends`` and overrides; errors of one line
- keys: the tree of keys, read off the types, for help and errors
- section: the base of every section
- study_settings: a study of ``polhode sweep``
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from polhode.config.backend_settings import Backend
from polhode.config.compare_settings import Compare
from polhode.config.frontend_settings import Frontend
from polhode.config.mapping_settings import Mapping
from polhode.config.scene_settings import Scene
from polhode.config.section import Section, Seed
from polhode.config.train_settings import Train

__all__ = [
    "Backend",
    "Compare",
    "Config",
    "Frontend",
    "KeyFrames",
    "Mapping",
    "Pictures",
    "Runtime",
    "Scene",
    "Train",
]


class Runtime(Section):
    """Use of the machine, not what is computed."""

    workers: int = Field(0, ge=0, le=1024)
    """Parallel processes; 0: one per core."""
    blas_threads: int = Field(1, ge=1, le=1024)
    """Threads of BLAS and OpenMP in each process: more than one was 5-8 times slower on small problems."""
    stages: Literal["kept", "while_running", "none"] = "kept"
    """Results of finished stages, from which run --resume goes on: kept in RUN/stages, for another
    configuration too; kept only until the run is complete, in case it is interrupted; or not stored."""


Output = Literal["motion", "surface", "pictures", "levels"]


class Pictures(Section):
    """Pictures of the map and of the model, in RUN/pictures."""

    frames: int = Field(30, ge=1, le=10_000)
    """Largest number of frames of the film, spread evenly over the sequence; the report shows up to 30."""


class KeyFrames(Section):
    """Long sequences: key frames give the map and the mass properties, the other frames are located in it."""

    above: int = Field(600, ge=10, le=1_000_000)
    """Sequences of more frames are solved by key frames; up to this number, by all frames at once."""
    number: int = Field(200, ge=8, le=2000)
    """Largest number of key frames. They are spread over the views of the target and over time."""

    @model_validator(mode="after")
    def _fewer(self) -> Self:
        if self.number > self.above:
            raise ValueError(f"number: {self.number} key frames are more than above: {self.above} frames")
        return self


class Config(Section):
    """One schema for every command: a scene (for simulate), the stages (for run), a training (for train)."""

    seed: Seed = 0
    """Seed of everything random."""
    outputs: tuple[Output, ...] = ("motion", "surface", "pictures")
    """What a run makes: the motion with mass properties and map, in any case; the mesh with what keeps its
    surroundings clear; pictures and film of the report; lighter meshes, and the mesh for them."""
    scene: Scene | None = None
    frontend: Frontend = Frontend()
    backend: Backend = Backend()
    mapping: Mapping = Mapping()
    key_frames: KeyFrames = KeyFrames()
    pictures: Pictures = Pictures()
    compare: Compare = Compare()
    train: Train | None = None
    runtime: Runtime = Runtime()

    @property
    def makes_surface(self) -> bool:
        """Whether depth and mesh are needed for what is wanted."""
        return not {"surface", "levels"}.isdisjoint(self.outputs)
