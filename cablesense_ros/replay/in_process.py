"""A recorded run through the same `Estimation`, as fast as it goes."""

from __future__ import annotations

from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_ros.replay.comparison import Comparison
from cablesense_ros.replay.estimate_table import EstimateTable
from cablesense_ros.replay.rebuilt_estimation import RebuiltEstimation
from cablesense_ros.replay.recorded_run import RecordedRun


def replay_in_process(
    run: RecordedRun, arm: str = "", model: str = "", table: EstimateTable | None = None
) -> Comparison:
    """Answer every recorded sample that the live estimator answered, and compare.

    The answers rest on the journal and the samples alone, so a bag that was played faster, read on
    another machine or begun in mid-move gives the same ones, as far as the processor's arithmetic
    and the versions of the libraries are the same.

    Args:
        run: the recording.
        arm: another than the recorded, or empty.
        model: another than the recorded, or empty.
        table: takes the answers, if any is wanted.

    Raises:
        RecordingError: the recording lacks what a replay needs.
        CableSenseError: the model is not to be found, or does not fit.
    """
    if not run.entries:
        raise RecordingError(
            f"{run.path}: has no ~/journal, and without it nobody knows the tare and the command "
            "at each sample; record with: cablesense record"
        )
    rebuilt = RebuiltEstimation(arm, model)
    comparison = Comparison()
    for entries, pair, taken in run.steps():
        comparison.samples += 1
        for entry in entries:
            rebuilt.follow(entry)
        if pair.answer is None:
            comparison.unanswered += 1
            if taken:  # a model with memory has heard it
                rebuilt.answer(pair.sample, pair.stamp_ns)
        elif rebuilt.loaded is None:
            comparison.before_journal += 1
        elif not rebuilt.vouches:
            rebuilt.answer(pair.sample, pair.stamp_ns)
            comparison.before_journal += 1
        else:
            answer = rebuilt.answer(pair.sample, pair.stamp_ns)
            comparison.compare(comparison.samples, pair.answer, answer)
            if table is not None:
                table.add(pair.stamp_ns, rebuilt.outcome, rebuilt.loaded.arm.segment_count)
    comparison.unstamped = run.pairs.unstamped
    comparison.lone_contacts = run.pairs.lone_contacts
    comparison.lone_zeros = run.pairs.lone_zeros
    return comparison
