# %% [markdown]
# # Diagnose a recording
#
#     python -m examples.diagnose_recording
#
# Which effect separates this recording of an arm from its simulation, where, and how far does the
# gap shrink once that effect is simulated? `cablesense gap diagnose` answers the same and writes a
# report.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from cablesense_gap import diagnose, write_diagnosis
from cablesense_plants.arm.blind_cases import record_cases
from cablesense_plants.arm.body import read_nominal
from cablesense_recording import read_recording
from cablesense_sim import open_arm
from cablesense_sim.arm import find_arm

RECORDING = Path("out/diagnose_recording/case_001.csv")  # yours, or it is simulated below
ARM = "cdsm_lab"  # a name, or the path of your arm file
EVERY = 6  # rows: enough here; take all of yours

# %% [markdown]
# Without a recording, an independent simulator makes one of an arm that carries a mass which its
# arm file does not have (`python -m cablesense_plants`).

# %%
if not RECORDING.exists():
    folder = RECORDING.parent
    nominal = read_nominal(find_arm(ARM))
    list(record_cases(folder, folder / "answers.csv", nominal, count=1, seed=7, only=["payload"]))

# %%
arm = open_arm(ARM)
# the simulated arm is built five times as well as by its file; drop this for yours
arm = arm.model_copy(update={"tolerances": arm.tolerances.scaled(0.2)})
diagnosis = diagnose(read_recording(RECORDING, arm).rows(slice(None, None, EVERY)), arm)
verdict = diagnosis.verdict
print(f"{', '.join(verdict.effects)} ({verdict.probability:.0%})")
for name, number in verdict.parameters.items():
    low, high = number.ci95
    print(f"  {name}: {number.value:.3g} {number.unit} ({low:.3g} to {high:.3g})")
print(f"gap: {verdict.gap.before_n:.2f} N, with it simulated {verdict.gap.after_n:.2f} N")
print(f"next: {verdict.next_experiment}")

# %% [markdown]
# The gap of each row, before and after. The report shows where it is.

# %%
figure, axes = plt.subplots(figsize=(8.0, 3.5), layout="constrained")
for residual_n, label in ((diagnosis.before_n, "nominal arm"), (diagnosis.after_n, "amended arm")):
    axes.plot(diagnosis.recording.time_s, np.sqrt((residual_n**2).mean(axis=1)), label=label)
axes.set(xlabel="time, s", ylabel="gap, N (RMS over cables)")
axes.legend()
write_diagnosis(RECORDING.parent / "diagnosis", diagnosis)
figure.savefig(RECORDING.with_suffix(".png"), dpi=110)
