"""The controls of the page: push the arm, move its joints, tare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from cablesense_ros.page.snapshot import Array

FORCE_LIMIT_N = 200.0
JOINT_LIMIT_DEG = 20.0


@dataclass(frozen=True)
class Push:
    """A push that a person asks for, normal to the segment at the commanded pose.

    Attributes:
        segment: 1 … N.
        angle_deg: from the segment's +z towards its +y.
        magnitude_n: newtons; 0 lets go.
    """

    segment: int
    angle_deg: float
    magnitude_n: float


@dataclass(frozen=True)
class Actions:
    """What the page asks of the world outside; each may be called from any thread.

    Attributes:
        push: takes a Push.
        command: takes joint angles (2N,), rad.
        tare: takes nothing.
    """

    push: Callable[[Push], None]
    command: Callable[[Array], None]
    tare: Callable[[], None]


class Controls:
    """Sliders and buttons in the main panel; what a person sets goes to `Actions`."""

    def __init__(
        self,
        gui: viser.GuiApi,
        segment_count: int,
        actions: Actions,
    ) -> None:
        self._actions = actions
        self._pushing = False
        with gui.add_folder("Push the arm"):
            self._segment = gui.add_dropdown(
                "segment",
                [str(n) for n in range(1, segment_count + 1)],
                initial_value=str(segment_count),
            )
            self._angle = gui.add_slider(
                "angle, °", 0, 355, 5, 215, hint="way of the force: 0° up, 90° to +y"
            )
            self._newtons = gui.add_slider("force, N", 0, int(FORCE_LIMIT_N), 1, 60)
            self._button = gui.add_button("Push", color="orange", icon=viser.Icon.HAND_FINGER)
        with gui.add_folder("Move the joints", expand_by_default=True):
            self._joints = [
                gui.add_slider(f"joint {n} {axis}, °", -JOINT_LIMIT_DEG, JOINT_LIMIT_DEG, 0.5, 0.0)
                for n in range(1, segment_count + 1)
                for axis in ("pitch", "yaw")
            ]
            home = gui.add_button("Home", icon=viser.Icon.HOME)
        with gui.add_folder("Estimator"):
            tare = gui.add_button(
                "Tare",
                icon=viser.Icon.SCALE,
                hint="takes the present tensions as those of the unloaded arm",
            )
        self._button.on_click(lambda _: self._toggle())
        for handle in (self._segment, self._angle, self._newtons):
            handle.on_update(lambda _: self._send_push())
        for joint in self._joints:
            joint.on_update(lambda event: self._send_command() if event.client else None)
        home.on_click(lambda _: self._go_home())
        tare.on_click(lambda _: actions.tare())

    @property
    def wanted(self) -> Push:
        """The push as the sliders stand; 0 N unless the button is down."""
        return Push(
            int(self._segment.value),
            float(self._angle.value),
            float(self._newtons.value) if self._pushing else 0.0,
        )

    def _toggle(self) -> None:
        self._pushing = not self._pushing
        self._button.label = "Release" if self._pushing else "Push"
        self._button.color = "gray" if self._pushing else "orange"
        self._actions.push(self.wanted)

    def _send_push(self) -> None:
        if self._pushing:
            self._actions.push(self.wanted)

    def _send_command(self) -> None:
        self._actions.command(np.deg2rad([float(joint.value) for joint in self._joints]))

    def _go_home(self) -> None:
        for joint in self._joints:
            joint.value = 0.0  # type: ignore[misc]  # mypy takes viser's setter for none
        self._send_command()
