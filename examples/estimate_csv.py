# %% [markdown]
# # Estimate offline from a CSV
#
#     python -m examples.estimate_csv
#
# Each row of a CSV has the commanded joint angles and the cable tensions (docs/recordings.md has
# the columns). The rows become forces, without ROS and without a running node.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from cablesense_contact import ContactState
from cablesense_online import KnownMachine
from cablesense_recording import Recording, read_recording
from cablesense_recording.csv_file import write_csv
from cablesense_sim import (
    mechanism_of,
    normal_force_n,
    open_arm,
    read_tensions_n,
    solve_equilibrium,
)

CSV = Path("out/estimate_csv/pushes.csv")  # yours, or it is simulated below
ARM = "cdsm"  # a name, or the path of an arm file
MODEL = ""  # the one of a bundled arm, or the path of a model file
TARE_ROWS = 20  # at the start, where nothing touches the arm

arm = open_arm(ARM)

# %% [markdown]
# Without a CSV one is simulated: a push on segment 3 of a bent arm that rises to 60 N and falls.

# %%
if not CSV.exists():
    CSV.parent.mkdir(parents=True, exist_ok=True)
    mechanism = mechanism_of(arm)
    pose_rad = np.deg2rad([4.0, 0.0, -3.0, 5.0, 0.0, 0.0, 2.0, -4.0])
    pushed_n = np.concatenate([np.zeros(40), 60.0 * np.hanning(120), np.zeros(40)])
    loads_n = normal_force_n(mechanism, pose_rad, 3, 200.0, pushed_n)
    commands_rad = np.tile(pose_rad, (len(pushed_n), 1))
    tensions_n = solve_equilibrium(mechanism, commands_rad, loads_n).tensions_n
    simulated = Recording(
        name="pushes",
        time_s=0.05 * np.arange(len(pushed_n), dtype=float),
        trial=np.zeros(len(pushed_n), dtype=int),
        command_rad=commands_rad,
        load_segment=np.where(pushed_n > 0.0, 3, 0),
        load_n=loads_n[:, 2],
        tensions_n=read_tensions_n(tensions_n, arm.sensors, np.random.default_rng(0)),
    )
    write_csv(CSV, simulated)

# %% [markdown]
# The first rows, where nothing touches the arm, are the tare: they update what the tolerances of
# the arm file say of this very arm. The law then takes all rows at once.

# %%
rows = read_recording(CSV, arm)
known = KnownMachine.load(ARM, MODEL)
known = known.tared(rows.tensions_n[:TARE_ROWS], rows.command_rad[0])

touches = known.touches(rows.tensions_n, rows.command_rad)
is_touched = np.array([touch.state is not ContactState.FREE for touch in touches])
force_n = np.where(is_touched, [touch.magnitude_n for touch in touches], 0.0)
intervals_n = np.array([touch.magnitude_ci95_n for touch in touches])
low_n, high_n = np.where(is_touched, intervals_n.T, 0.0)

for row in range(0, len(rows), 20):
    print(f"{rows.time_s[row]:5.1f} s  {touches[row]}")

# %%
figure, axes = plt.subplots(figsize=(8.0, 3.5), layout="constrained")
axes.plot(rows.time_s, np.linalg.norm(rows.load_n, axis=1), lw=4.0, alpha=0.4, label="true")
axes.plot(rows.time_s, force_n, label="estimated")
axes.fill_between(rows.time_s, low_n, high_n, alpha=0.3, label="with 95 %")
axes.set(xlabel="time, s", ylabel="force, N")
axes.legend()
figure.savefig(CSV.with_suffix(".png"), dpi=110)
