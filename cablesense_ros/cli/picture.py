"""`cablesense picture`: a machine, touched once, with the estimate and its interval, as PNG."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablesense_base.files import output_file, written_whole
from cablesense_ros.cli.options import ForceOption, OptionError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cablesense_msgs_py.messages import Contact
    from cablesense_online.page.shown import ShownMachine
    from cablesense_online.page.snapshot import Snapshot

_SIZE_PX = (760, 430)
_DPI = 100
_PUSH_SHARE = 0.25
"""Of the largest force that is expected, where none is asked for."""
_ANGLE_DEG = 215.0
"""From above and behind, so that the arrow is seen."""
_GL_PLATFORM = "egl"
"""MuJoCo's way to draw without a window; its default on Linux needs a screen."""


def picture(
    machine: Annotated[
        str, typer.Argument(help="Name of a bundled arm, or path of an arm file or machine file.")
    ],
    out: Annotated[Path, typer.Option(help="The picture to write, .png.")],
    model: Annotated[
        str, typer.Option(help="Model file. Default: the arm's own, or the one beside the file.")
    ] = "",
    link: Annotated[
        str, typer.Option(help="Segment number or link name.", show_default="the last one")
    ] = "",
    place: Annotated[
        float | None,
        typer.Option(help="Along the link's axis, mm.", show_default="where its middle is"),
    ] = None,
    angle: Annotated[
        float, typer.Option(help="Direction across the link, degrees from its z to its y axis.")
    ] = _ANGLE_DEG,
    newtons: Annotated[
        float | None,
        typer.Option(min=0.0, help="Force, N.", show_default="a quarter of the largest expected"),
    ] = None,
    built_seed: Annotated[
        int,
        typer.Option(min=-1, help="Seed of the errors with which it is built; -1: it has none."),
    ] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sensors' noise.")] = 0,
    force: ForceOption = False,
) -> None:
    """Draw a simulated machine that is touched: true force orange, estimated blue.

    The machine is built within its tolerances, tared once, then touched. The blue outline is the
    95 % interval of force and direction, the blue band that of the place.

    Example: cablesense picture finger.yaml --link distal --newtons 1.5 --out finger.png
    """
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", _GL_PLATFORM)  # before MuJoCo is imported
    import numpy as np

    from cablesense_online.loading import load
    from cablesense_online.opened_simulation import open_simulation
    from cablesense_online.page.opened import shown_machine
    from cablesense_online.page.still import still_picture
    from cablesense_online.simulation import SimulationSettings
    from cablesense_online.touched import touched_moment
    from cablesense_ros.default_settings import node_settings

    output_file(out, force=force, inputs=(machine, model))
    shown = shown_machine(machine)
    loaded = load(machine, model)
    contact = _contact(shown, link, place, angle, newtons)
    settings = node_settings()
    simulation = open_simulation(
        machine,
        SimulationSettings(
            rate_hz=0.0,
            joint_speed_rad_s=settings.joint_speed_rad_s,
            load_timeout_s=0.0,
            built_seed=built_seed,
        ),
        now_s=0.0,
    )
    rng = np.random.default_rng(seed)
    moment = touched_moment(shown, loaded, simulation, settings, contact, rng)
    lines = _lines(shown, moment)
    _save(out, still_picture(shown, moment, *_SIZE_PX), shown.felt.name, lines)
    typer.echo(moment.status.headline)
    typer.echo("\n".join(lines))
    typer.echo(f"picture: {out}")


def _contact(
    shown: ShownMachine, link: str, place_mm: float | None, angle_deg: float, force_n: float | None
) -> Contact:
    from cablesense_msgs_py.messages import Contact

    labels = shown.words.links
    label = link or labels[-1]
    if label not in labels:
        raise OptionError(
            f"--link {label} is no {shown.words.link} of {shown.felt.name}; it has "
            f"{', '.join(labels)}"
        )
    n = labels.index(label)
    first_m, last_m = shown.touched_m[n].tolist()
    place_m = float(shown.usual_m[n]) if place_mm is None else 1e-3 * place_mm
    if not first_m <= place_m <= last_m:
        raise OptionError(
            f"--place {place_mm:g} is not on {shown.words.of_link(n + 1)}, which is touched from "
            f"{1e3 * first_m:g} to {1e3 * last_m:g} mm"
        )
    size_n = _PUSH_SHARE * shown.strongest_n if force_n is None else force_n
    return Contact(n + 1, angle_deg % 360.0, size_n, place_m)


def _lines(shown: ShownMachine, moment: Snapshot) -> list[str]:
    """What is true, and what is estimated."""
    from cablesense_online.page.figures import interval_text, newtons_text, places_text

    words = shown.words

    def stated(contact: Contact) -> str:
        return (
            f"{words.of_link(contact.segment)}, {1e3 * contact.contact_m:.0f} mm, "
            f"{contact.angle_deg:.0f}°, {newtons_text(contact.magnitude_n)} N"
        )

    lines = [f"true:      {stated(moment.true[0])}"]
    if moment.estimated:
        lines.append(f"estimated: {stated(moment.estimated[0])}")
    else:
        lines.append(f"estimated: {moment.status.headline}")
    ends = []
    if moment.region:
        ends.append(places_text(moment.region, words))
    if moment.bounds is not None:
        if moment.bounds.angles_deg is not None:
            ends.append(f"{interval_text(*moment.bounds.angles_deg)}°")
        ends.append(f"{interval_text(moment.bounds.low_n, moment.bounds.high_n)} N")
    if ends:
        lines.append(f"95 %:      {', '.join(ends)}")
    return lines


def _save(path: Path, pixels: NDArray[np.uint8], title: str, lines: list[str]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from cablesense_online.page.colours import ESTIMATE_RGB, TRUE_RGB, css

    height_px, width_px, _ = pixels.shape
    figure = plt.figure(figsize=(width_px / _DPI, height_px / _DPI), dpi=_DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(pixels)
    axes.axis("off")
    axes.text(14, 26, title, color="white", fontsize=11, weight="bold")
    colours = (css(TRUE_RGB), css(ESTIMATE_RGB), css(ESTIMATE_RGB))
    for row, (line, colour) in enumerate(zip(lines, colours, strict=False)):
        axes.text(14, 48 + 19 * row, line, color=colour, fontsize=9, family="monospace")
    with written_whole(path, OptionError) as part:
        figure.savefig(part, dpi=_DPI, format="png", pil_kwargs={"optimize": True})
    plt.close(figure)
