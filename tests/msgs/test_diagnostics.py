"""A status becomes a diagnostic message."""

import pytest

from cablesense_msgs_py.diagnostics import Level, Status, diagnostic_statuses

pytestmark = pytest.mark.filterwarnings(
    "ignore:module .sre_:DeprecationWarning"
)  # lark, of rosidl


def test_fields_arrive():
    messages = pytest.importorskip("diagnostic_msgs.msg")
    status = Status("tare", Level.WARN, "none taken", {"readings": "0"})
    (message,) = diagnostic_statuses(
        [status], "estimator", "cdsm-1", messages.DiagnosticStatus, messages.KeyValue
    )
    assert message.name == "estimator: tare"
    assert message.level == messages.DiagnosticStatus.WARN
    assert message.hardware_id == "cdsm-1"
    assert [(v.key, v.value) for v in message.values] == [("readings", "0")]
