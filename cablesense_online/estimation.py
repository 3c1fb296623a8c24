"""An estimator that runs: its present state, which messages change and samples are answered from.

`contact_estimator` has the road of a sample. Here is what depends on when things come: whether
input is silent, which publisher is followed, and what is counted for diagnostics.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_contact.felt import FeltMachine
from cablesense_msgs_py.messages import breath_turn
from cablesense_online.answer import Answer
from cablesense_online.contact_estimator import ContactEstimator, EstimationState, Sample
from cablesense_online.contacts import ContactFinder
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.samples import SampleError
from cablesense_online.settings import LIVE_SETTINGS, EstimationSettings
from cablesense_online.statuses import SampleCounts
from cablesense_online.tare import Tare

BREATHER_SILENT_AFTER_S = 1.0
"""A breather that has sent nothing for this long in mid-breath is assumed to have gone."""


class Estimation:
    """Takes samples and commands as they come.

    Attributes:
        estimator: answers samples.
        state: the present one.
        publisher: the one whose samples are used.
        counts: of samples, for diagnostics.
    """

    def __init__(
        self,
        machine: FeltMachine,
        contacts: ContactFinder,
        settings: EstimationSettings,
        now_s: float,
        calibration: Calibration | None = None,
    ) -> None:
        """At rest, as well known as a calibration says, at monotonic time `now_s`.

        Raises:
            TareError: a calibration is given with a network, which takes none.
        """
        self.estimator = ContactEstimator(machine, contacts, settings)
        self.state: EstimationState = self.estimator.begin(calibration)
        self._breather_heard_s: float | None = None
        self.start(now_s)

    @property
    def settings(self) -> EstimationSettings:
        """Those in force; `adjust` changes some."""
        return self.estimator.settings

    def start(self, now_s: float) -> None:
        """Samples begin, or begin again, now; earlier ones do not count any more."""
        self.publisher = FollowedPublisher(self.settings.stale_after_s)
        self.counts = SampleCounts(now_s)
        self.state = self.state.anew

    def begin_at(self, pose_rad: Array) -> None:
        """Before the first sample: the arm rests at a pose (2N,), and not straight."""
        motion = self.estimator.gate.at_rest(pose_rad)
        self.state = self.state._replace(motion=motion)

    def follow(self, number: int, now_s: float) -> bool:
        """Whether another publisher is followed from the sample with this publication number on.

        To be called before `sample`, where several may publish, at monotonic time `now_s`.

        Raises:
            SampleError: it is not a sample of the followed publisher, so there is no answer to it.
        """
        try:
            is_another = self.publisher.accept(number, now_s)
        except SampleError as problem:
            self.counts.refuse(problem)
            raise
        if is_another:
            self.state = self.state.of_another_publisher
        return is_another

    def sample(self, raw: bytes, now_ns: int, now_s: float) -> Answer:
        """The answer to one serialized `JointState` of tensions.

        `now_ns` is of the clock that sets the stamps, `now_s` monotonic.
        """
        (answer,) = self.samples([raw], now_ns, now_s)
        return answer

    @property
    def most_together(self) -> int:
        """As many samples are best answered together where several wait."""
        return self.estimator.contacts.most_together

    def samples(self, raws: Sequence[bytes], now_ns: int, now_s: float) -> Iterator[Answer]:
        """The answers to samples that came together, in turn.

        Each is given as soon as it is known, and the state is then the one after that sample.
        """
        samples = [Sample(raw, now_ns, now_s) for raw in raws]
        answers = self.estimator.answers(self.state, samples)
        for sample, (state, answer) in zip(samples, answers, strict=True):
            self.state = state
            self.counts.count(sample, answer)
            yield answer

    def stale(self, now_s: float) -> bool:
        """Whether the last message is too old for its answer to be valid."""
        return self.counts.silence_s(now_s) > self.settings.stale_after_s

    def command(self, message: Any) -> bool:
        """Take over a `JointState` of commanded angles; gives whether the tare was dropped.

        That is where it was taken by itself, and the first command shows that the arm was not
        where it was assumed to be.

        Raises:
            CableSenseError: the message breaks the contract; the previous command stays in force.
        """
        tares = len(self.state.unloaded.tares)
        self.state = self.estimator.commanded(self.state, message)
        if breath_turn(message) is None:
            self.counts.commands += 1
        else:
            self._breather_heard_s = None
        return len(self.state.unloaded.tares) < tares

    def offset(self, message: Any) -> None:
        """Take over a `JointState` of lengths that are added to the cables' commanded ones.

        Raises:
            ContractError: the message breaks the contract.
        """
        self.state = self.estimator.offset(self.state, message)
        # an offset that is no breath's lasts, and need not be repeated
        self._breather_heard_s = None if breath_turn(message) is not None else float("inf")

    def miss_breather(self, now_s: float) -> bool:
        """Whether the breather has gone in mid-breath; its last command counts then.

        To be called again and again, at monotonic times `now_s`.
        """
        if self._breather_heard_s is None or not self.state.breath.breathing:
            self._breather_heard_s = now_s
        if now_s - self._breather_heard_s <= BREATHER_SILENT_AFTER_S:
            return False
        problem = "the breather fell silent in mid-breath"
        self.state = self.estimator.without_breather(self.state, problem)
        return True

    def take_tare(self, now_ns: int, *, forced: bool = False) -> Tare:
        """Take the latest readings as the unloaded state, at `now_ns` since the epoch.

        Raises:
            TareError: too few readings yet, they are not steady, or, unless `forced`, they are not
                those of the untouched arm.
        """
        self.state = self.estimator.tared(self.state, now_ns, forced=forced)
        return self.state.unloaded.tares[-1]

    def undo_tare(self, now_ns: int) -> Tare | None:
        """Return to the state before the last tare and give the one then in force, if any.

        The only tare is replaced by one of the latest readings, at `now_ns` since the epoch.

        Raises:
            TareError: there is nothing to undo, or nothing to replace the only tare.
        """
        self.state = self.estimator.tare_undone(self.state, now_ns)
        tares = self.state.unloaded.tares
        return tares[-1] if tares else None

    def calibrate(self, calibration: Calibration) -> None:
        """Take over a calibration.

        Raises:
            TareError: the model is a network, which takes none.
        """
        self.state = self.estimator.with_calibration(self.state, calibration)

    def restore(self, calibration: Calibration, command_rad: Array, *, known: bool) -> None:
        """Answer as a recorded estimator from the moment that it used a calibration.

        Raises:
            TareError: the model is a network, which takes none.
        """
        self.state = self.estimator.restored(
            self.state, calibration, np.asarray(command_rad), known=known
        )

    def adjust(self, contact_threshold: float, stale_after_s: float, slack_below_n: float) -> None:
        """Take over the settings that may change while running."""
        values = (contact_threshold, stale_after_s, slack_below_n)
        changed = dict(zip(LIVE_SETTINGS, values, strict=True))
        self.estimator = self.estimator.adjusted(self.settings.model_copy(update=changed))
        self.publisher.stale_after_s = stale_after_s
