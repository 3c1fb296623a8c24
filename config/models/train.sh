#!/bin/sh
# Trains every bundled model again, as `make models` does; one processor thread, an hour and a half.
# The same commands, seed 0, stand in the files themselves: cablesense info config/models/cdsm.onnx
set -eu
cd "$(dirname "$0")/../.."
train() { ${CABLESENSE:-cablesense} train --force --threads 1 "$@"; }
here=config/models
mkdir -p $here/peers

for arm in cdsm cdsm_lab; do
    train --arm $arm --network anywhere --out $here/${arm}_anywhere.onnx
done
for arm in cdsm cdsm_lab cdsm_table2; do
    train --arm $arm --network closed-form-corrected --out $here/$arm.onnx
done
train --arm cdsm --network scale-aware --out $here/cdsm_tensions_only.onnx
train --arm cdsm --network multi-contact-closed-form --pose straight --out $here/cdsm_multi.onnx

for arm in cdsm cdsm_lab cdsm_table2; do
    train --arm $arm --network closed-form --out $here/peers/${arm}_closed_form.onnx
done
train --arm cdsm --network two-stage --out $here/peers/cdsm_two_stage.onnx
train --arm cdsm --network two-stage --pose straight --out $here/peers/cdsm_straight_two_stage.onnx
train --arm cdsm_table2 --network two-stage --pose straight --out $here/peers/cdsm_table2_two_stage.onnx
train --arm cdsm --network multi-contact --pose straight --out $here/peers/cdsm_multi_two_stage.onnx

# with memory: in motion, and under friction
train --arm cdsm --network temporal --samples 96 --epochs 40 --out $here/cdsm_moving.onnx
train --arm cdsm_friction --network temporal --samples 640 --epochs 30 --out $here/cdsm_friction.onnx
train --arm cdsm_friction --network history-simulated --out $here/cdsm_friction_simulated.onnx
