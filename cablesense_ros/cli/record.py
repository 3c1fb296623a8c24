"""`cablesense record`: everything that running nodes say, into one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def record(
    out: Annotated[Path, typer.Option(help="The .mcap file to write.")],
    duration: Annotated[
        float | None,
        typer.Option(min=0.1, help="Seconds to record.", show_default="until Ctrl-C"),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of the nodes.")] = "",
) -> None:
    """Record all topics of the contract from running nodes, as rosbag2 MCAP.

    Tensions, commands and loads, the estimator's answers and its journal, diagnostics, joint
    states, the robot description. Opens in Foxglove and PlotJuggler, plays in `ros2 bag play`,
    and `cablesense replay` gives the same estimates again. A recorder that is killed loses half a
    second. Ctrl-C ends it.

    Example: cablesense record --out run.mcap
    """
    from rich.console import Console

    from cablesense_msgs_py.topic_types import CONTRACT
    from cablesense_ros.recording_session import record_topics

    record_topics(out, CONTRACT, duration, None, Console(), namespace)
