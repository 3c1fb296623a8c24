"""Effects in words for people who have never seen the tool: what each is, what to look at."""

from __future__ import annotations

from typing import NamedTuple


class EffectWords(NamedTuple):
    """What an effect is, and what someone at the arm can do about it."""

    is_: str
    look: str = ""


_WORDS = {
    "capstan_friction": EffectWords(
        "friction of the cables over guides and pulleys",
        "Look for worn, dry or misaligned guides. The estimator is blind to loads within the loop "
        "that friction opens; train it on the amended arm.",
    ),
    "joint_friction": EffectWords(
        "dry friction in joints",
        "Move the joint by hand with slack cables; look for dry or jammed bearings.",
    ),
    "cable_creep": EffectWords(
        "cables that creep under load",
        "Pre-stretch the cables, or tare again after every long hold.",
    ),
    "cable_stiffness": EffectWords(
        "cables of another stiffness than stated",
        "Measure a cable's stiffness on a bench, from command to anchor; look for another kind or "
        "length of cable, and for a soft anchor.",
    ),
    "actuator_backlash": EffectWords(
        "lost motion of actuators on reversal",
        "Check couplings and nuts of these actuators, or approach poses from one side.",
    ),
    "sensor_gain": EffectWords(
        "a wrong scale of tension sensors",
        "Hang known weights on these sensors and set their scale anew.",
    ),
    "sensor_offset": EffectWords(
        "a constant zero error of tension sensors",
        "Set the zero of these sensors with slack cables. A tare hides it from the estimator.",
    ),
    "sensor_drift": EffectWords(
        "a zero of tension sensors that wanders",
        "Let the sensors warm up; look at their supply and cabling; tare often.",
    ),
    "sensor_crosstalk": EffectWords(
        "crosstalk between tension sensors",
        "Look at shared wiring, ground and amplifier of these channels.",
    ),
    "sensor_lag": EffectWords(
        "tension sensors that follow late",
        "Look at the filter settings of these channels; all should be alike.",
    ),
    "payload": EffectWords(
        "mass that nobody modelled",
        "Weigh what was added there: tools, hoses, covers.",
    ),
    "base_tilt": EffectWords(
        "a base that is not level",
        "Put a level on the base; level it, or keep the tilt in the arm file.",
    ),
    "routing_geometry": EffectWords(
        "guide holes on another radius or at another angle",
        "Measure radius and angle of these holes.",
    ),
    "contact_offset": EffectWords(
        "loads that act elsewhere along the segment than stated",
        "Measure where the load was applied, from the segment's joint centre.",
    ),
    "joint_elasticity": EffectWords(
        "joints that spring back",
        "Look for a sheath, a hose or a bundle through the middle of the arm.",
    ),
    "pretension_error": EffectWords(
        "cables tensioned to another value",
        "Tension these cables anew with the arm straight, or keep the values in the arm file.",
    ),
}


def effect_words(name: str) -> EffectWords:
    """Words for an effect; one that a user has added keeps its name."""
    return _WORDS.get(name, EffectWords(name.replace("_", " ")))
