"""What an interrupted diagnosis has simulated, in files from which the same diagnosis goes on.

Everything that a diagnosis does follows from the readings and from what the simulator predicts,
and simulating takes most of its time. So the predictions are kept, as they were computed, to the
last bit: a diagnosis that begins again takes them from the files, fits and chooses as before, and
comes to the same verdict as one that was never interrupted.
"""

from __future__ import annotations

import inspect
import json
import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

import cablesense_gap
import cablesense_recording
import cablesense_sim
from cablesense_base import Array, CableSenseError
from cablesense_base.files import written_whole
from cablesense_gap.simulator import Assignment, Candidate, Simulator, small_changes
from cablesense_sim.effects.registry import known_effects

FOLDER = "unfinished"
"""Name of the folder beside the files of a diagnosis."""
_WORTH_KEEPING_S = 0.02
"""A prediction that took less time is computed as fast as it is read."""
_LEAST_FREE_SHARE = 0.1
"""Of the disk: with less, no more is kept, and a resumed diagnosis simulates the rest anew."""
_PACKAGES = (cablesense_gap, cablesense_recording, cablesense_sim)


class KeptSimulationsError(CableSenseError):
    """The folder of kept simulations cannot be written to."""


@dataclass(frozen=True)
class KeptSimulations:
    """A folder of predictions, all of one recording, machine and version of the code.

    Attributes:
        folder: of files named by what was asked; made with the first of them.
        count: of the predictions that were there when it was opened.
    """

    folder: Path
    count: int

    @classmethod
    def of_command(
        cls, out: Path, inputs: Iterable[Path], settings: Sequence[object]
    ) -> KeptSimulations:
        """The folder of a command in its folder `out`; predictions of other commands are deleted.

        A command is the same if its `inputs` have the same content, wherever they lie and whatever
        they are called, and its `settings` are equal: those that change what is simulated or
        compared. What changes only how it is run, as `--workers` and `--force`, is none of them.
        The sources count too: another version of the code discards what this one has kept.

        Raises:
            KeptSimulationsError: earlier predictions cannot be deleted.
        """
        digest = sha256(json.dumps(list(settings), default=str).encode())
        for path in (*_files(inputs), *_code()):
            digest.update(sha256(path.read_bytes()).digest())
        folder = out / FOLDER / digest.hexdigest()[:16]
        try:
            for other in (out / FOLDER).glob("*"):
                if other != folder:
                    shutil.rmtree(other)
        except OSError as error:
            raise KeptSimulationsError(
                f"{out / FOLDER}: cannot be deleted ({error.strerror}); give another --out"
            ) from error
        return cls(folder, sum(1 for _ in folder.glob("*.npy")))

    def simulator(self, simulator: Simulator) -> KeptSimulator:
        """A simulator whose predictions are kept here."""
        return KeptSimulator(simulator, self.folder)

    def delete(self) -> None:
        """Delete the predictions, as of a diagnosis that is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):  # others are in it
            self.folder.parent.rmdir()


class KeptSimulator:
    """A `Simulator` that predicts as another one, and takes from files what it has kept there."""

    def __init__(self, simulator: Simulator, folder: Path) -> None:
        """Take the simulator, and the folder of predictions for the same recording."""
        self._simulator = simulator
        self._folder = folder
        nominal = simulator.predict([{}])
        self._identity = sha256(repr(nominal.shape).encode() + nominal.tobytes()).hexdigest()

    @property
    def candidates(self) -> Sequence[Candidate]:
        """Effects to choose among."""
        return self._simulator.candidates

    @property
    def tolerances(self) -> Sequence[Candidate]:
        """Manufacturing tolerances."""
        return self._simulator.tolerances

    @property
    def floor(self) -> float:
        """Root mean square of what the sensors add to a perfect reading."""
        return self._simulator.floor

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, R, C) of P variants; simulated unless they are in a file."""
        return self._kept("predict", variants, lambda: self._simulator.predict(variants))

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """Changes (P, R, C) by small differences from a base; simulated unless in a file."""
        return self._kept(
            "small_changes",
            [base, *variants],
            lambda: small_changes(self._simulator, base, variants),
        )

    def _kept(
        self, what: str, variants: Sequence[Assignment], simulate: Callable[[], Array]
    ) -> Array:
        """What was simulated before of these variants, or is now."""
        values = [
            sorted((str(term), float(value).hex()) for term, value in variant.items())
            for variant in variants
        ]
        name = sha256(json.dumps([self._identity, what, values]).encode()).hexdigest()
        path = self._folder / f"{name}.npy"
        if path.exists():
            return np.asarray(np.load(path, allow_pickle=False))
        begin_s = time.perf_counter()
        simulated = simulate()
        took_long = time.perf_counter() - begin_s > _WORTH_KEEPING_S
        if took_long and self._has_room():
            with written_whole(path, KeptSimulationsError) as beside, beside.open("wb") as file:
                np.save(file, simulated, allow_pickle=False)
        return simulated

    def _has_room(self) -> bool:
        """Whether the disk has room for more; the folder exists afterwards."""
        self._folder.mkdir(parents=True, exist_ok=True)
        disk = shutil.disk_usage(self._folder)
        return disk.free > _LEAST_FREE_SHARE * disk.total


def _files(inputs: Iterable[Path]) -> Iterable[Path]:
    """The files of recordings, which may be folders."""
    for path in inputs:
        yield from sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else (path,)


def _code() -> Iterable[Path]:
    """The sources that a prediction and its use depend on, with those of foreign effects."""
    folders = [Path(str(package.__file__)).parent for package in _PACKAGES]
    sources = {path for folder in folders for path in folder.rglob("*.py")}
    sources |= {Path(inspect.getfile(type(effect))) for effect in known_effects().values()}
    return sorted(sources)
