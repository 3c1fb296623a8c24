"""The columns of a recording as a table: their names, and how many decimals each is written to."""

from __future__ import annotations

from typing import Final

TIME: Final = "time_s"
TRIAL: Final = "trial"
LOAD_SEGMENT: Final = "load_segment"
LOAD: Final = ("load_x_n", "load_y_n", "load_z_n")

TIME_DECIMALS: Final = 6
COMMAND_DECIMALS: Final = 6
"""A microradian moves the tension of a stiff cable by less than a sensor's step."""
LOAD_DECIMALS: Final = 4
TENSION_DECIMALS: Final = 4


def command_columns(joint_count: int) -> list[str]:
    """`q1_cmd_rad` … for 2N joint angles, pitch then yaw of each joint, base first."""
    return [f"q{i + 1}_cmd_rad" for i in range(joint_count)]


def tension_columns(cable_count: int) -> list[str]:
    """`tension_1_n` … for M cables."""
    return [f"tension_{i + 1}_n" for i in range(cable_count)]


def all_columns(joint_count: int, cable_count: int) -> list[str]:
    """Every column, in the order of the file."""
    return [
        TIME,
        TRIAL,
        *command_columns(joint_count),
        LOAD_SEGMENT,
        *LOAD,
        *tension_columns(cable_count),
    ]
