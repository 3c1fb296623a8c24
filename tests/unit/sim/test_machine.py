"""Machine files and models: those that cannot be used are refused in one line."""

from pathlib import Path

import pytest

from cablesense_sim.machine.description import MachineError, read_machine_file
from cablesense_sim.machine.machine import open_machine

MODEL = """
<mujoco>
  <worldbody>
    <geom name="floor" size="1 1 0.1" type="plane" contype="0" conaffinity="0"/>
    <site name="start" pos="-0.1 0 0.02"/>
    <body name="base">
      <geom size="0.02"/>
      <body name="link">
        <joint name="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01"/>
        <site name="end" pos="0.1 0 0.02"/>
        <body name="follower" pos="0.2 0 0">
          <joint name="following" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="cable"><site site="start"/><site site="end"/></spatial>
    <spatial name="spring" stiffness="100"><site site="start"/><site site="end"/></spatial>
  </tendon>
  <equality><joint joint1="following" joint2="hinge"/></equality>
  <actuator><position name="drive" tendon="cable" kp="1e4"/></actuator>
  <keyframe><key name="home" qpos="0.1 0.1"/></keyframe>
</mujoco>
"""
FILE = """
name: machine
model: machine.xml
joints: commanded
sensors:
  tension: {of: [cable], noise_std: 0.1}
cables: {pretension_n: 20, unread: [spring]}
touch:
  links:
    - {link: link, start_m: [0, 0, 0], end_m: [0.2, 0, 0]}
"""


def opened(folder: Path, model: str = MODEL, file: str = FILE) -> Path:
    (folder / "machine.xml").write_text(model)
    path = folder / "machine.yaml"
    path.write_text(file)
    return path


def refusal(path: Path) -> str:
    """The one line that a machine is refused with."""
    with pytest.raises(MachineError) as caught:
        open_machine(path)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 500
    return line


def test_a_machine_is_what_file_and_model_say(tmp_path: Path) -> None:
    machine = open_machine(opened(tmp_path))
    assert machine.coordinates.names == ("hinge",)
    assert machine.channels.names == ("cable",)
    assert machine.tendons.names == ("cable", "spring")
    assert machine.tendons.stiffness_n_m.tolist() == [1e4, 100.0]
    assert machine.command_names == ("hinge",)
    assert not machine.is_measured


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("tension: {of: [cable], noise_std: 0.1}", "{}", "no sensors"),
        ("of: [cable]", "of: [rope]", "tendon rope is not in machine.xml"),
        ("of: [cable]", "of: [cable, cable]", "twice"),
        ("noise_std: 0.1", "noise_std: 0", "neither noise nor step"),
        ("noise_std: 0.1", "noise_std: 0.1, range: [5, 1]", "lowest, highest"),
        (", unread: [spring]", "", "nothing reads tendon spring"),
        ("pretension_n: 20", "pretension_n: {rope: 20}", "cables.pretension_n names rope"),
        ("pretension_n: 20, ", "", "cables.pretension_n"),
        ("link: link", "link: arm", "touch.links names arm"),
        ("link: link", "link: base", "link base does not move"),
        ("end_m: [0.2, 0, 0]", "end_m: [0, 0, 0]", "no axis"),
        ("joints: commanded", "joints: actuators", "no position servo draws tendon spring"),
        ("joints: commanded", "joints: commanded\nlocked: [elbow]", "locked names joint elbow"),
        ("joints: commanded", "joints: commanded\nlocked: [hinge]", "none can give way"),
        ("joints: commanded", "joints: commanded\nreference: away", "reference: away"),
        ("tension:", "torque: {of: [hinge], noise_std: 0.1}\n  tension:", "joints: measured"),
        (
            "joints: commanded\nsensors:\n  tension: {of: [cable], noise_std: 0.1}",
            "joints: measured\nsensors:\n  torque: {of: [following], noise_std: 0.1}",
            "nothing reads tendon cable",
        ),
    ],
)
def test_a_file_that_does_not_fit_is_refused(
    tmp_path: Path, was: str, now: str, said: str
) -> None:
    assert was in FILE
    line = refusal(opened(tmp_path, file=FILE.replace(was, now)))
    assert "machine.yaml" in line
    assert said in line


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ('<joint name="hinge" axis="0 1 0"/>', '<joint name="hinge" type="ball"/>', "ball"),
        ('<body name="base">', '<body name="base"><freejoint name="free"/>', "free"),
        ('<joint name="hinge" axis="0 1 0"/>', '<joint axis="0 1 0"/>', "MuJoCo cannot read"),
        (' kp="1e4"', ' kp="0"', "has no stiffness"),
        (
            '<joint joint1="following" joint2="hinge"/>',
            '<connect body1="follower" anchor="0 0 0"/>',
            "closes a loop",
        ),
        (
            '<joint joint1="following" joint2="hinge"/>',
            '<joint joint1="following" joint2="hinge"/><joint joint1="hinge" joint2="following"/>',
            "in a circle",
        ),
        (
            '<joint joint1="following" joint2="hinge"/>',
            '<joint joint1="following" joint2="hinge"/><joint joint1="following"/>',
            "two equalities tie joint following; leave one of them in the model",
        ),
        ("<mujoco>", "<mujoco", "MuJoCo cannot read"),
    ],
)
def test_a_model_that_statics_do_not_know_is_refused(
    tmp_path: Path, was: str, now: str, said: str
) -> None:
    assert was in MODEL
    model = MODEL.replace(was, now)
    if "free" in now or "ball" in now:
        model = model.replace(
            '<equality><joint joint1="following" joint2="hinge"/></equality>', ""
        )
        model = model[: model.index("<keyframe>")] + "</mujoco>"
    assert said in refusal(opened(tmp_path, model=model))


def test_controls_of_a_servo_with_its_own_scale_are_taken_as_such(tmp_path: Path) -> None:
    """Of a servo with 50 u - 1e4 g l, a length l just leaves the tendon slack at u = 200 g l."""
    affine = 'gainprm="50" biastype="affine" biasprm="0 -1e4"'
    servo = f'<general name="drive" tendon="cable" gear="2" {affine}/>'
    model = MODEL.replace('<position name="drive" tendon="cable" kp="1e4"/>', servo)
    machine = open_machine(opened(tmp_path, model=model))
    assert machine.tendons.gear.tolist() == [400.0, 1.0]
    assert machine.tendons.stiffness_n_m.tolist() == [4e4, 100.0]


def test_a_machine_with_measured_joints_needs_no_pretension(tmp_path: Path) -> None:
    file = FILE.replace("pretension_n: 20, ", "").replace("commanded", "measured")
    assert open_machine(opened(tmp_path, file=file)).is_measured


def test_one_error_of_all_springs_needs_springs(tmp_path: Path) -> None:
    file = FILE + "tolerances: {common_joint_stiffness_share: 0.1}"
    assert "joints with springs" in refusal(opened(tmp_path, file=file))


def test_a_model_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = opened(tmp_path, file=FILE.replace("machine.xml", "other.xml"))
    assert "other.xml" in refusal(path)


def test_an_attached_file_is_part_of_the_identity(tmp_path: Path) -> None:
    part = '<mujoco><worldbody><body name="part"/></worldbody></mujoco>'
    (tmp_path / "part.xml").write_text(part)
    model = MODEL.replace(
        "<worldbody>", '<asset><model name="part" file="part.xml"/></asset><worldbody>'
    )
    model += '<!-- <include file="of_old.xml"/> -->'
    path = opened(tmp_path, model=model)
    before = read_machine_file(path).identity
    (tmp_path / "part.xml").write_text(part.replace('"part"', '"other"'))
    assert read_machine_file(path).identity != before
