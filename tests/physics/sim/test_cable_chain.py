"""Cables as elastic pieces that stick and slip at guides: closed forms, admissibility, work."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim.cable_chain import CableChains

RUN_N_M = 2e5
SPAN_N_M = 5e5
PHI = 0.3


def chains(
    *, pieces: tuple[float, ...], limit: list[float], start=0.0, give=0.0, pull=50.0, rounding=0.0
):
    """One cable of pieces with stiffnesses, N/m, tensioned to `pull` where it carries no share."""
    compliance = 1.0 / np.array([pieces])
    lengths = np.zeros_like(compliance)
    lengths[0, 0] = pull * compliance.sum()
    phi = np.array([limit])
    share = np.full_like(phi, start)
    return CableChains(compliance, lengths, phi, share, give, rounding), lengths, phi


def walked(cable, lengths, phi, steps):
    """Tensions (R, K) after each step, a change (R, K) of the pieces' lengths."""
    tensions = []
    for step in steps:
        lengths = lengths + step
        tensions.append(cable.pull(lengths, phi).tensions_n[0])
        cable.settle(lengths, phi)
    return np.array(tensions)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_over_one_guide_the_tensions_are_apart_by_the_capstan_equation(sign: float) -> None:
    cable, lengths, phi = chains(pieces=(RUN_N_M, SPAN_N_M), limit=[PHI])
    wound = np.array([[sign * 2e-4, 0.0]])
    near, far = walked(cable, lengths, phi, [wound])[0]
    assert near / far == pytest.approx(np.exp(sign * PHI), rel=1e-12)
    stretch = 50.0 * (1 / RUN_N_M + 1 / SPAN_N_M) + sign * 2e-4
    assert near / RUN_N_M + far / SPAN_N_M == pytest.approx(stretch, rel=1e-12)


def test_a_run_that_sticks_keeps_its_tension_to_the_last_digit() -> None:
    """The load that drew the cable out is taken off: the run does not notice."""
    cable, lengths, phi = chains(pieces=(RUN_N_M, SPAN_N_M), limit=[PHI])
    on = np.array([[0.0, 3e-4]])
    off = np.array([[0.0, -2e-5]])
    tensions = walked(cable, lengths, phi, [on, off, off])
    assert tensions[0, 1] / tensions[0, 0] == pytest.approx(np.exp(PHI))
    assert (tensions[1:, 0] == tensions[0, 0]).all()
    np.testing.assert_allclose(np.diff(tensions[:, 1]), -2e-5 * SPAN_N_M, rtol=1e-9)


@st.composite
def histories(draw):
    """A cable, and changes of its pieces' lengths that slacken it now and then."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(2, 5))
    give = draw(st.sampled_from([0.0, 2e-7, 1e-6, 2e-5]))
    rounding = draw(st.sampled_from([0.0, 0.5, 0.95]))
    compliance = 10.0 ** rng.uniform(-7.0, -5.0, (8, count))
    compliance[:4, draw(st.integers(2, count)) :] = 0.0
    lengths = np.zeros_like(compliance)
    lengths[:, 0] = 50.0 * compliance.sum(-1)
    limit = rng.uniform(0.0, 0.5, (8, count - 1)) * draw(st.sampled_from([1.0, 1e-3]))
    share = np.clip(rng.uniform(-2.0, 2.0, limit.shape), -1.0, 1.0)
    cable = CableChains(compliance, lengths, limit, share, give, rounding)
    steps = rng.normal(0.0, 20.0, (12, *compliance.shape)) * compliance
    return cable, compliance, lengths, limit, steps, give


@pytest.mark.slow
@given(histories())
@settings(max_examples=20, deadline=None)
def test_every_step_is_admissible_and_keeps_the_material(history) -> None:
    """Within the bounds, slip only at them and only with them, no cable gained, no energy won."""
    cable, compliance, lengths, limit, steps, give = history
    joined = compliance[:, 1:] > 0.0
    stretch = None
    was_taut = joined
    for step in steps:
        lengths = lengths + step
        tensions = cable.pull(lengths, limit).tensions_n
        whole = lengths.sum(-1)
        np.testing.assert_allclose(
            (tensions * compliance).sum(-1), np.maximum(whole, 0.0), atol=1e-12
        )
        taut = joined & (whole > 0.0)[:, None]
        apart = np.log(
            np.where(taut, tensions[:, :-1], 1.0) / np.where(taut, tensions[:, 1:], 1.0)
        )
        assert (np.abs(apart) <= limit + 1e-9).all()
        if stretch is not None and give == 0.0:
            # towards the actuator goes what the pieces before the node lost beyond their lengths
            passed = np.cumsum(stretch + step - tensions * compliance, -1)[:, :-1]
            slips = taut & was_taut & (np.abs(passed) > 1e-12)
            np.testing.assert_allclose(apart[slips], (np.sign(passed) * limit)[slips], atol=1e-7)
            lost = (tensions[:, :-1] - tensions[:, 1:]) * passed
            assert (lost[slips] >= -1e-9).all()
        cable.settle(lengths, limit)
        stretch = tensions * compliance
        was_taut = taut


@given(histories())
@settings(max_examples=10, deadline=None)
def test_slopes_are_the_derivatives_by_the_lengths(history) -> None:
    cable, compliance, lengths, limit, steps, _ = history
    for step in steps[:3]:
        lengths = lengths + step
        cable.settle(lengths, limit)
    lengths = lengths + steps[3]
    pull = cable.pull(lengths, limit)
    for k in range(compliance.shape[-1]):
        moved = 1e-7 * compliance[:, k] * 50.0
        sides = []
        for sign in (1.0, -1.0):
            other = lengths.copy()
            other[:, k] += sign * moved
            sides.append(cable.pull(other, limit).tensions_n)
        exists = moved > 0.0
        slope = (sides[0] - sides[1])[exists] / (2.0 * moved[exists, None])
        slopes = pull.by_length_n_m[exists][..., k]
        scale = 1.0 / compliance[compliance > 0.0].min()
        # a kink may lie just there
        assert np.quantile(np.abs(slope - slopes) / scale, 0.95) < 1e-4


@pytest.mark.parametrize("rounding", [0.0, 0.3, 0.95])
@pytest.mark.parametrize("start", [0.0, -0.6])
def test_bristles_near_their_limit_as_dahl_has_it(rounding: float, start: float) -> None:
    """What is left to it, u = 1 - share, falls as du/dx = -u^rounding / give, x passed."""
    give = 3e-5
    reached = 4e-5
    cable, lengths, phi = chains(
        pieces=(RUN_N_M, SPAN_N_M), limit=[PHI], start=start, give=give, rounding=rounding
    )
    before = cable.pull(lengths, phi).tensions_n[0]
    near, far = walked(cable, lengths, phi, [np.array([[1e-4, 0.0]])])[0]
    passed = (far - before[1]) / SPAN_N_M
    assert 0.0 < passed < reached
    step = 1e-9
    u = 1.0 - start
    for _ in range(round(passed / step)):
        u = max(u - step * u**rounding / give, 0.0)
    assert np.log(near / far) == pytest.approx(PHI * (1.0 - u), abs=1e-3 * PHI)
