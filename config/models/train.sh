#!/bin/sh
# Makes every bundled model again, as `make models` does: the estimators in a minute, the paper's
# networks by training on one processor thread, in half an hour.
# The same commands, seed 0, stand in the files themselves: cablesense info peers/cdsm_two_stage
set -eu
cd "$(dirname "$0")/../.."
cablesense=${CABLESENSE:-cablesense}
here=config/models
mkdir -p $here/peers

for arm in cdsm cdsm_lab cdsm_table2 cdsm_friction; do
    $cablesense export --force --arm $arm --out $here/${arm}_anywhere.onnx
done

train() { $cablesense train --force --threads 1 "$@"; }
train --arm cdsm --network two-stage --out $here/peers/cdsm_two_stage.onnx
train --arm cdsm --network two-stage --pose straight --out $here/peers/cdsm_straight_two_stage.onnx
train --arm cdsm_table2 --network two-stage --pose straight --out $here/peers/cdsm_table2_two_stage.onnx
train --arm cdsm --network multi-contact --pose straight --out $here/peers/cdsm_multi_two_stage.onnx
