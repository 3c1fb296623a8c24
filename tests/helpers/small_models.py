"""A model of few operators, to be changed in any way before it is opened."""

import numpy as np
import pytest
from onnx import TensorProto, helper

from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.estimator import OUTPUTS, Estimator
from cablesense_sim.arm import open_arm
from tests.helpers.model_fixtures import metadata_for

CDSM = open_arm("cdsm")
FLOAT = TensorProto.FLOAT
DOUBLE = TensorProto.DOUBLE
RANKS = dict(zip(OUTPUTS, (2, 2, 1, 1, 1), strict=True))


def value(name, kind, shape):
    """The declaration of an input or output."""
    return helper.make_tensor_value_info(name, kind, shape)


def weights(name, rows, columns, kind=DOUBLE):
    """A constant matrix of numbers between -1 and 1."""
    numbers = np.linspace(-1.0, 1.0, rows * columns)
    return helper.make_tensor(name, kind, [rows, columns], numbers.tolist())


def small_model(kind=DOUBLE, nodes=(), initializers=(), inputs=None, properties=None, arm=CDSM):
    """A tensions-only model of few operators; `nodes` replace those that write the same."""
    usual_nodes = [
        helper.make_node("MatMul", ["tension_difference_n", "classes"], ["logits"]),
        helper.make_node("Softmax", ["logits"], ["contact_probability"], axis=-1),
        helper.make_node("MatMul", ["tension_difference_n", "turn"], ["direction"]),
        helper.make_node(
            "ReduceL2", ["tension_difference_n", "last"], ["magnitude_n"], keepdims=0
        ),
        helper.make_node("Exp", ["magnitude_n"], ["magnitude_std_n"]),
        helper.make_node("Sqrt", ["magnitude_n"], ["angle_std_deg"]),
    ]
    replaced = {name for node in nodes for name in node.output}
    graph = helper.make_graph(
        [*(node for node in usual_nodes if not replaced & set(node.output)), *nodes],
        "small",
        inputs or [value("tension_difference_n", kind, ["batch", arm.cable_count])],
        [value(name, kind, ["batch", f"{name}s"][:rank]) for name, rank in RANKS.items()],
        initializer=[
            weights("classes", arm.cable_count, arm.segment_count + 1, kind),
            weights("turn", arm.cable_count, 2, kind),
            helper.make_tensor("last", TensorProto.INT64, [1], [-1]),
            *initializers,
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    if properties is None:
        properties = metadata_for(arm, pose_aware=False, network="small").to_properties()
    helper.set_model_props(model, properties)
    return model


def written(tmp_path, model):
    """The path of a file with a model in it, or with any bytes."""
    path = tmp_path / "model.onnx"
    path.write_bytes(model if isinstance(model, bytes) else model.SerializeToString())
    return path


def refused(path, kind=Estimator, arm=None):
    """The one line in which a file is refused; it names the file."""
    with pytest.raises(ModelFileError) as caught:
        kind.load(path, arm)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message
