"""Checks of a recording: a sound one passes, and each planted fault is found where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.protocol import rows_of, standard_protocol
from cablesense_recording.checks import check_form, check_recording
from cablesense_recording.csv_file import write_csv
from cablesense_recording.reading import read_recording
from cablesense_recording.recording import EXCHANGED, Finding, RecordingError, refuse_unusable
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.mechanism import with_cables_moved
from cablesense_sim.replay import read_tensions_n
from tests.helpers.gap_recordings import small_recording

LAB = open_arm("cdsm_lab")
MECHANISM = mechanism_of(LAB)
ROWS = rows_of(standard_protocol(LAB), 2.0)


def of_kind(found: list[Finding], kind: str) -> list[Finding]:
    return [finding for finding in found if finding.kind == kind]


def refused(found: list[Finding]) -> bool:
    return any(finding.refuses for finding in found)


def tensions_of(mechanism, recording):
    return solve_equilibrium(mechanism, recording.command_rad, recording.forces_n).tensions_n


BARE = replace(ROWS, tensions_n=np.zeros((len(ROWS), 12)))
NOMINAL = tensions_of(MECHANISM, BARE)
SOUND = replace(BARE, tensions_n=read_tensions_n(NOMINAL, LAB.sensors, np.random.default_rng(0)))


def with_(row, field, value, source=SOUND):
    changed = np.array(getattr(source, field), copy=True)
    changed[row] = value
    return replace(source, **{field: changed})


def with_tensions(change, source=SOUND):
    tensions = source.tensions_n.copy()
    return replace(source, tensions_n=change(tensions))


def only(found):
    (finding,) = found
    return finding


def test_a_sound_recording_has_nothing_to_find():
    assert check_recording(SOUND, LAB, NOMINAL) == []
    assert check_recording(SOUND, LAB) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"stiffness_n_m": 0.4 * MECHANISM.stiffness_n_m},
        {"mass_kg": MECHANISM.mass_kg + np.array([0.0, 0.0, 0.0, 0.5])},
        {"pretension_n": MECHANISM.pretension_n - 15.0},
        {"contact_m": MECHANISM.contact_m + 0.03},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_gross_effects_of_an_arm_are_no_fault_of_the_recording(changes):
    read = tensions_of(replace(MECHANISM, **changes), BARE)
    assert check_recording(replace(BARE, tensions_n=read), LAB, NOMINAL) == []


@pytest.mark.parametrize(
    ("broken", "kind", "said"),
    [
        (with_((9, 4), "tensions_n", np.nan), "numbers", "tension_5_n .* row 10;"),
        (with_((0, 7), "command_rad", np.inf), "numbers", "q8_cmd_rad"),
        (with_(30, "time_s", 1.0), "time", "time_s is 1 in row 31, of another clock"),
        (with_(slice(40, 45), "load_segment", 0), "label", "row"),
        (with_(12, "load_segment", 5), "segment", r"is 5 in row 13; it must be from 1 to 4"),
        (with_(12, "load_segment", -1), "segment", "is -1"),
        (replace(SOUND, command_rad=np.rad2deg(SOUND.command_rad)), "degrees", "rad"),
        (with_((5, 2), "command_rad", 0.7), "bend", "row 6"),
        (with_(15, "load_n", [0.0, 0.0, 9e3]), "load", "2000 N in row 16"),
        (
            replace(SOUND, load_at_m=np.where(np.arange(len(SOUND)) == 24, 0.2, 0.03)),
            "place",
            r"load_at_m is 0.2 in row 25; on segment . it must be from 0 to 0.13 m",
        ),
        (replace(SOUND, tensions_n=SOUND.tensions_n[:, :9]), "cables", "has 9 tensions"),
        (replace(SOUND, command_rad=SOUND.command_rad[:, :6]), "joints", "has 6 commanded"),
        (SOUND.rows(slice(0, 0)), "rows", "no rows"),
        (SOUND.rows(slice(0, 8)), "amount", "in 1 trials"),
    ],
)
def test_what_rules_a_recording_out_is_reported_with_its_place(broken, kind, said):
    findings = check_recording(broken, LAB)
    assert of_kind(findings, kind), findings
    assert refused(findings)
    assert findings[0].refuses
    with pytest.raises(RecordingError, match=said):
        refuse_unusable(broken, findings)


@pytest.mark.parametrize(
    ("odd", "kind", "said"),
    [
        (with_(slice(100, None), "trial", 0), "trial", "trial 0 comes back"),
        (with_((205, 0), "command_rad", 0.4), "jump", "rows 206 to 207"),
        (SOUND.rows(np.r_[0:30, 300:380]), "amount", "only 110 rows"),
    ],
)
def test_what_is_odd_is_a_warning(odd, kind, said):
    findings = check_recording(odd, LAB)
    assert not refused(findings)
    assert any(said in finding.text for finding in of_kind(findings, kind)), findings


@pytest.mark.parametrize(("one", "other"), [(1, 2), (2, 9), (5, 12)])
def test_exchanged_channels_are_named(one, other):
    order = np.arange(12)
    order[[one - 1, other - 1]] = order[[other - 1, one - 1]]
    exchanged = with_tensions(lambda t: t[:, order])
    finding = only(check_recording(exchanged, LAB, NOMINAL))
    assert (finding.refuses, finding.kind) == (True, EXCHANGED)
    assert f"tension_{one}_n reads cable_{other}" in finding.text
    assert f"tension_{other}_n reads cable_{one}" in finding.text
    with pytest.raises(RecordingError, match="or continue with --force"):
        refuse_unusable(exchanged, [finding])
    refuse_unusable(exchanged, [finding], force=True)


def test_a_dead_and_a_dying_channel_are_stuck():
    def dead(tensions):
        tensions[:, 3] = 0.0
        return tensions

    def dying(tensions):
        tensions[500:, 6] = tensions[499, 6] + 1.0
        return tensions

    for nominal in (None, NOMINAL):
        assert (
            "tension_4_n is 0 N"
            in of_kind(check_recording(with_tensions(dead), LAB, nominal), "stuck")[0].text
        )
    finding = only(check_recording(with_tensions(dying), LAB, NOMINAL))
    assert finding.kind == "stuck"
    assert f"tension_7_n stands still in rows 501 to {len(SOUND)}" in finding.text


def test_saturation_is_found_with_and_without_a_stated_range():
    clipped = with_tensions(lambda t: np.minimum(t, 90.0))
    findings = of_kind(check_recording(clipped, LAB, NOMINAL), "saturated")
    assert any(finding.text.startswith("tension_1_n does not exceed 90 N") for finding in findings)
    sensors = LAB.sensors.model_copy(update={"range_n": (0.0, 90.0)})
    stated = LAB.model_copy(update={"sensors": sensors})
    findings = of_kind(check_recording(clipped, stated), "saturated")
    assert any("tension_1_n is at the end of the sensors' range, 90 N" in f.text for f in findings)


def test_another_arm_and_other_units_are_refused():
    rng = np.random.default_rng(1)
    still = np.zeros(MECHANISM.cable_count)
    half_a_turn = np.full(MECHANISM.cable_count, np.pi)
    mirrored = with_cables_moved(MECHANISM, still, half_a_turn)
    for tensions, kind in (
        (tensions_of(mirrored, BARE), "arm"),
        (rng.normal(50.0, 10.0, NOMINAL.shape), "arm"),
        (NOMINAL / 9.81, "unit"),
    ):
        findings = check_recording(replace(BARE, tensions_n=tensions), LAB, NOMINAL)
        assert refused(findings)
        assert of_kind(findings, kind), findings


def test_reading_refuses_what_has_no_form_and_takes_what_is_merely_short(tmp_path):
    write_csv(tmp_path / "short.csv", SOUND.rows(slice(0, 3)))
    assert len(read_recording(tmp_path / "short.csv", LAB)) == 3
    write_csv(tmp_path / "degrees.csv", replace(SOUND, command_rad=np.rad2deg(SOUND.command_rad)))
    with pytest.raises(RecordingError, match=r"degrees: .*seem to be degrees"):
        read_recording(tmp_path / "degrees.csv", LAB)
    assert refused(check_form(with_((9, 4), "tensions_n", np.nan), LAB))


@pytest.mark.parametrize(
    ("factor", "kind"),
    [
        (1e3, "milliseconds"),
        (1e6, "microseconds"),
        (1e9, "nanoseconds"),
        (800.0, "milliseconds"),
        (30.0, "rate"),
        (2e3, "rate"),
    ],
)
def test_times_in_another_unit_or_of_another_rate_are_named(factor, kind):
    made = small_recording()
    (findings,) = check_form(replace(made, time_s=factor * made.time_s), LAB)
    assert findings.kind == kind
    assert findings.refuses == (kind != "rate")
    assert kind == "rate" or f"in s, not in {kind}" in findings.text
    assert not check_form(made, LAB)
