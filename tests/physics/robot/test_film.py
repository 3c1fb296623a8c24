"""The film of a robot's report: its motion, and whether bodies are where kinematics say."""

import base64
import io
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from PIL import Image

from cablesense_gap.report import film
from cablesense_gap.report.page import robot_page
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotDiagnosis, RobotSystem
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import ChannelGap
from tests.helpers.html_page import Page
from tests.helpers.rendering import need_renderer
from tests.helpers.two_link import recorded, write_model
from tests.helpers.verdict_cases import gap_of, verdict_of

FRICTION_N_M = 0.15
ROD = """
<mujoco>
  <worldbody>
    <body name="rod">
      <joint name="pivot" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 -0.05 0 0 -0.5" size="0.02" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """The diagnosis of a pendulum that rubs at the elbow; a fit gave just that."""
    folder = tmp_path_factory.mktemp("rubbing")
    robot = load_robot(write_model(folder))
    recording = recorded(folder / "recording.csv", friction=(0.0, FRICTION_N_M), noise_n_m=1e-4)
    motion = prepared(read_robot_recording(recording, robot), robot)
    system = RobotSystem(robot, motion, {})
    amended = {Term("joint_friction", "elbow", "torque_n_m"): FRICTION_N_M}
    before, after = (system.predict([effects])[0] * system.scale for effects in ({}, amended))
    gap = gap_of(45.9, 1.1, 1.0).model_copy(update={"effects_n": 1.2})
    channels = {"elbow": ChannelGap(unit="N·m", before=1.0, after=0.1, floor=0.1)}
    verdict = verdict_of("joint_friction", gap=gap, channels=channels, rows=9)
    in_floors = verdict.model_copy(update={"unit": "floors"})
    return RobotDiagnosis(system, in_floors, amended, before, after, ("Compared.",), (), {})


@pytest.fixture(scope="module")
def clip(rubbing):
    return film.chosen_clip(rubbing)


def rendered(model, clip):
    need_renderer()
    return film.rendered_film(model, clip)


def frames_of(animation):
    """(F, H, W, 3) of a WebP file."""
    image = Image.open(io.BytesIO(animation))
    frames = []
    for number in range(image.n_frames):
        image.seek(number)
        frames.append(np.asarray(image.convert("RGB"), dtype=float))
    return np.array(frames)


def test_the_amended_model_stays_with_the_measured_motion(rubbing, clip):
    nominal, amended = clip.predictions
    assert nominal.position[0] == pytest.approx(clip.measured[0], abs=1e-9)
    away_rad = [np.abs(model.position - clip.measured).max() for model in (nominal, amended)]
    assert away_rad[0] > 10.0 * away_rad[1]
    assert away_rad[1] < 0.02


def test_the_measured_motion_is_that_of_the_recording(rubbing, clip):
    trial = rubbing.system.motion.trials[clip.trial]
    frame_s = np.linspace(clip.begin_s, clip.begin_s + clip.span_s, len(clip.measured))
    for joint in range(2):
        recorded_rad = np.interp(frame_s, trial.time_s, trial.position[:, joint])
        assert clip.measured[:, joint] == pytest.approx(recorded_rad, abs=1e-3)


def test_a_model_that_is_not_amended_is_shown_once(rubbing):
    as_it_was = RobotDiagnosis(
        rubbing.system, rubbing.verdict, {}, rubbing.before, rubbing.before, (), (), {}
    )
    (nominal,) = film.chosen_clip(as_it_was).predictions
    assert nominal.label == "nominal model"


@pytest.mark.slow
def test_bodies_are_where_kinematics_say():
    model = mujoco.MjModel.from_xml_string(ROD)
    turning = np.linspace(0.0, 0.5 * np.pi, 12)[:, None]
    still = np.zeros_like(turning)
    prediction = film.Prediction("nominal model", "#E69F00", turning)
    animation, poster = rendered(model, film.Clip(0, 0.0, 1.0, still, (prediction,)))
    frames = frames_of(animation)
    red, _green, blue = np.moveaxis(frames, -1, 0)
    orange = red - blue > 60.0
    dark = frames.max(axis=-1) < 140.0
    at_px = np.array([_middle_px(dark[-1]), *map(_middle_px, orange[[6, -1]])])
    data = mujoco.MjData(model)
    places = []
    for angle_rad in (0.0, turning[6, 0], turning[-1, 0]):
        data.qpos[0] = angle_rad
        mujoco.mj_kinematics(model, data)
        places.append(data.geom_xpos[0, [0, 2]])  # seen along y: x to the right, z up
    moved_m = np.diff(places, axis=0)
    moved_px = np.diff(at_px, axis=0)
    scale_px_m = np.linalg.norm(moved_px, axis=1) / np.linalg.norm(moved_m, axis=1)
    assert moved_px == pytest.approx(scale_px_m[0] * moved_m, abs=3.0)
    standing = np.asarray(Image.open(io.BytesIO(poster)).convert("RGB"), dtype=float)
    assert np.abs(standing - frames[-1]).mean() < 3.0


def _middle_px(mask):
    """Middle of what a mask (H, W) has, to the right and up."""
    rows, columns = np.nonzero(mask)
    return columns.mean(), -rows.mean()


@pytest.mark.slow
def test_the_page_holds_a_film_that_moves(rubbing):
    need_renderer()
    page = Page(robot_page(rubbing, "folder"))
    assert all(source.startswith("data:") for source in page.sources)
    webp = "data:image/webp;base64,"
    films = [source.removeprefix(webp) for source in page.sources if source.startswith(webp)]
    poster, animation = map(base64.b64decode, films)
    assert len(poster) < len(animation) < 1_000_000
    frames = frames_of(animation)
    assert len(frames) / 15.0 == pytest.approx(4.0, abs=1.0)
    changes = np.abs(np.diff(frames, axis=0)).max(axis=(1, 2, 3))
    assert (changes > 50.0).mean() > 0.9
    assert "There is no film" not in page.text


def test_a_page_without_a_driver_has_a_line_instead(rubbing, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "no such driver")
    page = robot_page(rubbing, "folder")
    assert "There is no film of the motion: no driver for graphics" in page
    assert "no such driver: " in page  # and what it said
    assert "data:image/webp" not in page


def test_positions_of_a_camera_have_no_film(rubbing):
    external = SimpleNamespace(external=True)
    system = SimpleNamespace(robot=rubbing.system.robot, motion=external)
    with pytest.raises(film.FilmError, match="outside the drives"):
        film.chosen_clip(SimpleNamespace(system=system))
