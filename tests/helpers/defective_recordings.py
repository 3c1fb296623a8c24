"""Recordings of an arm and of a robot as tables, with one defect each, and their files."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from cablesense_recording.csv_file import write_csv
from cablesense_recording.recording import Recording
from cablesense_sim.arm import open_arm
from cablesense_sim.replay import replay_arm
from tests.helpers.bags import write_joint_states, write_mcap
from tests.helpers.two_link import recorded

LAB = open_arm("cdsm_lab")
ARM_ROWS = 120
ARM_STEP_S = 0.2
ARM_COMMANDS = [f"q{number}_cmd_rad" for number in range(1, 9)]
ARM_TENSIONS = [f"tension_{number}_n" for number in range(1, 13)]


@dataclass
class Defect:
    """A table with a defect, and what a reader may call it.

    Attributes:
        table: the changed one.
        names: any of these in what is said names the defect.
    """

    table: pd.DataFrame
    names: list[str] = field(default_factory=list)


def robot_table(folder):
    """Three trials of the two-link pendulum, one clock."""
    whole = pd.read_csv(recorded(folder / "sound.csv", trials=3))
    table = whole.filter(regex="time_s|trial|position|torque")
    short = table.groupby("trial").head(200).reset_index(drop=True)
    return short.assign(time_s=np.arange(len(short)) * 0.01)


def arm_table():
    """Ten trials of held poses without loads, as the arm of the file reads them."""
    rng = np.random.default_rng(0)
    held = np.repeat(rng.uniform(-0.15, 0.15, (ARM_ROWS // 6, 8)), 6, axis=0)
    columns = {"time_s": ARM_STEP_S * np.arange(ARM_ROWS), "trial": np.arange(ARM_ROWS) // 12}
    columns |= dict(zip(ARM_COMMANDS, held.T, strict=True))
    unread = dict.fromkeys(ARM_TENSIONS, np.zeros(ARM_ROWS))
    tensions = replay_arm(LAB, arm_recording(pd.DataFrame(columns | unread)).course)
    noisy = tensions + rng.normal(0.0, 0.02, tensions.shape)
    return pd.DataFrame(columns | dict(zip(ARM_TENSIONS, noisy.T, strict=True)))


def arm_recording(table):
    """The table as a recording in memory, without any check."""
    rows = len(table)
    return Recording(
        name="made",
        time_s=table["time_s"].to_numpy(float),
        trial=table["trial"].to_numpy(float),
        command_rad=table[ARM_COMMANDS].to_numpy(float),
        load_segment=np.zeros(rows, dtype=np.int64),
        load_n=np.zeros((rows, 3)),
        tensions_n=table[ARM_TENSIONS].to_numpy(float),
    )


def write_robot_csv(path, table):
    table.to_csv(path.with_suffix(".csv"), index=False)
    return path.with_suffix(".csv")


def write_robot_bag(path, table):
    return write_joint_states(path.with_suffix(".mcap"), _numbered(table))


def write_arm_csv(path, table):
    write_csv(path.with_suffix(".csv"), arm_recording(table))
    return path.with_suffix(".csv")


def write_arm_bag(path, table):
    came_s = (50.0, ARM_STEP_S)
    recording = arm_recording(_numbered(table))
    write_mcap(path.with_suffix(".mcap"), recording, LAB, arrives_s=came_s)
    return path.with_suffix(".mcap")


def _numbered(table):
    """With trials in every row: a topic's number holds until the next."""
    return table.assign(trial=table.trial.ffill())


def _measured(table):
    """Channels of sensors, and those of positions or commands."""
    sensors = [name for name in table if name.startswith(("torque", "tension"))]
    return sensors, [name for name in table if name.startswith(("position", "q"))]


def _with(table, label, rows, values):
    column = table[label].to_numpy(float, copy=True)
    column[rows] = values
    return table.assign(**{label: column})


def _row(table, rng, edge=0.1):
    """A row of the inner part, and its number as people count."""
    row = int(rng.integers(int(edge * len(table)), int((1.0 - edge) * len(table))))
    return row, row + 1


def _shifted(table, rng, seconds):
    row, number = _row(table, rng)
    later = seconds * (np.arange(len(table)) >= row)
    return Defect(table.assign(time_s=table.time_s + later), [f"row {number}", f"rows {number}"])


def clock_set_back(table, rng):
    step_s = float(np.diff(table.time_s)[0])
    return _shifted(table, rng, -step_s * rng.uniform(2.0, 50.0))


def clock_set_back_by_a_day(table, rng):
    return _shifted(table, rng, -86_400.0 * rng.uniform(0.5, 3.0))


def clock_set_forward(table, rng):
    return _shifted(table, rng, 10.0 ** rng.uniform(0.5, 9.3))


def paused(table, rng):
    step_s = float(np.diff(table.time_s)[0])
    return _shifted(table, rng, step_s * rng.uniform(20.0, 400.0))


def row_twice(table, rng):
    row, number = _row(table, rng)
    doubled = pd.concat([table[: row + 1], table[row:]])
    return Defect(doubled.reset_index(drop=True), [f"row {number + 1}"])


def rows_exchanged(table, rng):
    row, number = _row(table, rng)
    order = np.arange(len(table))
    order[[row, row + 1]] = row + 1, row
    return Defect(table.iloc[order].reset_index(drop=True), [f"row {number}", f"row {number + 1}"])


def rows_reversed(table, rng):
    return Defect(table[::-1].reset_index(drop=True), ["time_s"])


def trials_in_another_order(table, rng):
    order = rng.permutation(table.trial.unique())
    while (np.diff(order) > 0).all():
        order = rng.permutation(order)
    parts = [table[table.trial == number] for number in order]
    return Defect(pd.concat(parts).reset_index(drop=True), ["time_s"])


def later_stamp(table, rng):
    row, number = _row(table, rng)
    stamp_s = 10.0 ** rng.uniform(6.0, 9.3)
    return Defect(_with(table, "time_s", row, stamp_s), [f"row {number}"])


def earlier_stamp(table, rng):
    row, number = _row(table, rng, 0.3)
    stamp_s = rng.uniform(0.0, 0.05) * table.time_s.iloc[row]
    return Defect(_with(table, "time_s", row, stamp_s), [f"row {number}"])


def two_clocks_by_turns(table, rng):
    other_s = table.time_s.to_numpy(copy=True)
    other_s[1::2] += rng.uniform(1e3, 1e6)
    return Defect(table.assign(time_s=other_s), ["time_s"])


def time_stands_still(table, rng):
    return Defect(table.assign(time_s=3.0), ["time_s"])


def time_in_bursts(table, rng):
    size = int(rng.integers(8, 20))
    count = np.arange(len(table))
    step_s = float(np.diff(table.time_s)[0])
    return Defect(
        table.assign(time_s=size * step_s * (count // size) + 1e-6 * (count % size)),
        ["time_s", "rows come"],
    )


def milliseconds(table, rng):
    return Defect(table.assign(time_s=1e3 * table.time_s), ["milliseconds"])


def microseconds(table, rng):
    return Defect(table.assign(time_s=1e6 * table.time_s), ["time_s", "microseconds"])


def stamps_jitter(table, rng):
    step_s = float(np.diff(table.time_s)[0])
    jitter_s = step_s * rng.uniform(-0.3, 0.3, len(table))
    return Defect(table.assign(time_s=table.time_s + jitter_s))


def rows_lost(table, rng):
    kept = rng.random(len(table)) > 0.03
    kept[0] = True
    return Defect(table[kept].reset_index(drop=True))


def half_the_rate_from_somewhere(table, rng):
    row, _ = _row(table, rng, 0.3)
    kept = (np.arange(len(table)) < row) | (np.arange(len(table)) % 2 == 0)
    return Defect(table[kept].reset_index(drop=True))


def _sensor(table, rng):
    return str(rng.choice(_measured(table)[0]))


def sensor_is_zero(table, rng):
    label = _sensor(table, rng)
    return Defect(table.assign(**{label: 0.0}), [label])


def sensor_is_constant(table, rng):
    label = _sensor(table, rng)
    return Defect(table.assign(**{label: float(rng.uniform(0.1, 50.0))}), [label])


def sensor_dies(table, rng):
    label = _sensor(table, rng)
    row = int(rng.uniform(0.3, 0.7) * len(table))
    return Defect(_with(table, label, slice(row, None), table[label].iloc[row]), [label])


def sensor_begins_late(table, rng):
    label = _sensor(table, rng)
    row = int(rng.uniform(0.3, 0.7) * len(table))
    return Defect(_with(table, label, slice(0, row), table[label].iloc[0]), [label])


def sensor_is_missing_in_some_rows(table, rng):
    label = _sensor(table, rng)
    row, _ = _row(table, rng, 0.2)
    rows = slice(row, row + int(rng.integers(1, 30)))
    return Defect(_with(table, label, rows, np.nan), [label])


def sensor_is_missing_at_first(table, rng):
    label = _sensor(table, rng)
    count = int(rng.integers(1, len(table) // 4))
    names = [label, f"The first {count} of"]
    return Defect(_with(table, label, slice(0, count), np.nan), names)


def sensor_is_missing_at_last(table, rng):
    label = _sensor(table, rng)
    count = int(rng.integers(1, len(table) // 4))
    names = [label, f"The last {count} of"]
    return Defect(_with(table, label, slice(len(table) - count, None), np.nan), names)


def sensor_is_infinite(table, rng):
    label = _sensor(table, rng)
    row, _ = _row(table, rng)
    return Defect(_with(table, label, row, np.inf * rng.choice([-1.0, 1.0])), [label])


def sensor_is_huge(table, rng):
    label = _sensor(table, rng)
    row, _ = _row(table, rng)
    return Defect(_with(table, label, row, 10.0 ** rng.uniform(13.0, 300.0)), [label])


def place_is_missing_in_some_rows(table, rng):
    label = str(rng.choice(_measured(table)[1]))
    row, _ = _row(table, rng, 0.2)
    rows = slice(row, row + int(rng.integers(1, 30)))
    return Defect(_with(table, label, rows, np.nan), [label, "position of joint_"])


def place_is_huge(table, rng):
    label = str(rng.choice(_measured(table)[1]))
    row, _ = _row(table, rng)
    return Defect(
        _with(table, label, row, 10.0 ** rng.uniform(4.0, 300.0)), [label, "position", "angle"]
    )


def places_in_degrees(table, rng):
    places = _measured(table)[1]
    changed = {label: 180.0 / np.pi * table[label] for label in places}
    return Defect(table.assign(**changed), ["degrees", "position", "command"])


def place_is_constant(table, rng):
    places = _measured(table)[1]
    label = str(rng.choice(places))
    if "position" in label:
        return Defect(table.assign(**{label: 0.05}), [label])
    return Defect(table.assign(**dict.fromkeys(places, 0.05)), ["no command changes"])


def place_is_set_anew(table, rng):
    label = str(rng.choice(_measured(table)[1]))
    row, number = _row(table, rng)
    shift = 0.3 * (np.arange(len(table)) >= row)
    return Defect(
        table.assign(**{label: table[label] + shift}), [label, f"row {number}", "command"]
    )


def place_fails_once(table, rng):
    label = str(rng.choice(_measured(table)[1]))
    row, number = _row(table, rng)
    return Defect(_with(table, label, row, 0.8), [label, f"row {number}", f"rows {number}"])


def place_fails_now_and_then(table, rng):
    label = str(rng.choice(_measured(table)[1]))
    rows = slice(int(rng.integers(5, 20)), None, int(rng.integers(15, 40)))
    return Defect(_with(table, label, rows, 0.8), [label, "command"])


def a_trial_comes_back(table, rng):
    changed = table.trial.to_numpy(copy=True)
    changed[changed == changed[-1]] = changed[0]
    return Defect(table.assign(trial=changed), ["rial 0 comes back"])


def trials_are_not_numbered_in_some_rows(table, rng):
    row, _ = _row(table, rng, 0.2)
    changed = table.assign(trial=table.trial.astype(float))
    return Defect(_with(changed, "trial", slice(row, row + 20), np.nan), ["trial"])


def trial_numbers_are_huge(table, rng):
    return Defect(table.assign(trial=table.trial + 1_000_000), [])


def no_trial_but_one(table, rng):
    return Defect(table.assign(trial=7), ["rial"])


def few_rows(table, rng):
    count = int(rng.integers(0, 3))
    return Defect(table[:count], ["row", "no message", "none", "misses", "holds no"])


DEFECTS = {
    function.__name__: function
    for function in (
        clock_set_back,
        clock_set_back_by_a_day,
        clock_set_forward,
        paused,
        row_twice,
        rows_exchanged,
        rows_reversed,
        trials_in_another_order,
        later_stamp,
        earlier_stamp,
        two_clocks_by_turns,
        time_stands_still,
        time_in_bursts,
        milliseconds,
        microseconds,
        stamps_jitter,
        rows_lost,
        half_the_rate_from_somewhere,
        sensor_is_zero,
        sensor_is_constant,
        sensor_dies,
        sensor_begins_late,
        sensor_is_missing_in_some_rows,
        sensor_is_missing_at_first,
        sensor_is_missing_at_last,
        sensor_is_infinite,
        sensor_is_huge,
        place_is_missing_in_some_rows,
        place_is_huge,
        places_in_degrees,
        place_is_constant,
        place_is_set_anew,
        place_fails_once,
        place_fails_now_and_then,
        a_trial_comes_back,
        trials_are_not_numbered_in_some_rows,
        trial_numbers_are_huge,
        no_trial_but_one,
        few_rows,
    )
}
"""Each changes a sound table (R rows) by draws of a generator."""
