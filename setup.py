"""One ROS 2 package made of Python packages, and the one place that declares its dependencies.

`constraints.txt` holds the exact versions; here stand the names, the reason for each, and the
bounds that are known to matter.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "cablesense_ros"

# What an estimator needs, beside the messages of ROS. Whatever a robot's computer does without
# stands in an extra, as an extra can only add.
REQUIRES = [
    "lazy-loader",  # public names of a package, imported when first used
    "numpy>=1.26",  # arrays everywhere; ROS 2 Jazzy on Ubuntu has 1.26
    "onnx",  # checks a model file before it is run
    "onnxruntime",  # runs the trained model
    "pydantic>=2",  # arm files are validated, and refused with reasons
    "PyYAML",  # reads arm files
    "rich",  # tables and progress bars in the terminal
    "typer",  # the `cablesense` command
]

ROBOT = [
    "cantools",  # decodes and encodes frames by a DBC file
    "python-can[serial]",  # every CAN adapter; serial for those that speak slcan
]
SIM = [
    "mujoco>=4.0",  # the arm's physics; 4.0 brought the integrator that carries stiff cables
    "numba",  # equilibria of arms, and arms with friction row by row, in compiled code
    "scipy",  # Numba's linear algebra; least squares and statistics elsewhere
]
PAGE = [
    *SIM,
    "jinja2",  # the figures on the page
    "matplotlib",  # the picture of a headless demo, pictures of an evaluation
    "msgspec",  # reads what a browser sends, before viser does
    "trimesh",  # surfaces of a machine's shapes
    "viser",  # the 3D page in the browser
    "websockets",  # viser's server, whose requests are checked
]
# ROS 2 Jazzy without a ROS installation; a machine with Jazzy from apt needs none of these
ROS = [
    "ros-jazzy-common-interfaces",  # the standard messages of the contract
    "ros-jazzy-rclpy",  # rclpy and the message runtime
    "ros-rclpy[fastrtps]==7.1.6",  # the middleware; other releases do not fit the two above
]

EXTRAS = {
    "robot": ROBOT,  # a robot's computer with ROS: estimator, CAN driver, commissioner, breather
    "sim": SIM,  # the simulated arm
    "page": PAGE,
    "ros": ROS,
    "demo": [*ROBOT, *PAGE, *ROS],  # `cablesense demo` on a computer without ROS
    "gap": [
        *SIM,
        "jinja2",  # the report's page
        "lz4",  # unpacks chunks to a bound, where mcap, which brings it, has none
        "matplotlib",  # the report's pictures
        "mcap",  # reads recordings record by record, also one that breaks off
        "pandas",  # recordings and tables of residuals
        "pillow",  # the report's film
        "rosbags",  # message types, folders of rosbag2 and its writer, without a ROS installation
        "zstandard",  # as lz4, for what rosbag2 packs by default
    ],
    "train": [
        *SIM,
        "distributed",  # datasets, and series of recordings, on a Dask cluster
        "onnxscript",  # torch exports through it
        "pillow",  # the animation of an example in few colours
        "pyarrow>=14.0.1",  # datasets are Parquet; older releases run code that a file brings
        "scikit-learn",  # the gradient-boosting baseline
        "torch==2.13.0",  # trains the networks; exact, so that a model can be made again
    ],
    "benchmarks": [
        "absl-py",  # logs of mujoco.sysid, beside which a benchmark puts the diagnosis
        "colorama",  # colours of the same
        "tabulate",  # tables of the same
    ],
    "docs": [
        "mkdocs",  # the documentation as a site
        "mkdocs-material",  # its theme, with search
        "mkdocstrings[python]",  # its reference of the API, from signatures and docstrings
        "pymdown-extensions",  # anchors as GitHub makes them, code in colour
    ],
    "test": [
        "pytest"  # `colcon test` takes it for a package that names it under this extra
    ],
    "dev": [
        "catkin-pkg",  # reads package.xml, in tests
        "check-jsonschema",  # schemas of workflows, issue forms and CITATION.cff
        "colcon-core",  # the real build of the ROS package, in a test
        "colcon-ros",  # colcon's knowledge of package.xml
        "hypothesis",  # tests over wide inputs
        "import-linter",  # the dependencies between packages
        "jupytext",  # reads the notebooks of examples, which have the cells of their scripts
        "mypy",  # types
        "packaging",  # reads requirements, in tests and `make lock`
        "pillow",  # looks at what the browser shows, in the page's test
        "pytest<9.2",  # the tests; with 9.2, pytest-xdist 3.8 takes no notice of groups
        "pytest-rerunfailures",  # repeats tests of several processes that fail, and lists them
        "pytest-timeout",  # a test that hangs fails instead
        "pytest-xdist",  # the tests on all cores
        "ruff",  # style
        "setuptools<80",  # colcon builds with the setup.py commands that 80 took away
        "types-PyYAML",  # types of yaml
        "types-protobuf",  # types of google.protobuf, which those of onnx build on
        "uv",  # installs the demo, and writes the hashes of `make lock`
    ],
}


FOLDERS = {"cablesense_training": "training"}
"""Packages whose folder has another name."""

REPOSITORY_ONLY = ["cablesense_plants", "cablesense_plants.*"]
"""The independent simulators test the diagnosis; a robot has no use for them."""


def packages() -> list[str]:
    """List the Python packages, those whose folder has another name included."""
    listed = find_packages(include=["cablesense_*"], exclude=REPOSITORY_ONLY)
    for package, folder in FOLDERS.items():
        listed += [package, *(f"{package}.{name}" for name in find_packages(folder))]
    return listed


def long_description() -> str:
    """The README without what is not in a distribution: pictures, and links to other files."""
    text = Path("README.md").read_text(encoding="utf-8")
    text = re.sub(r"^!\[.*?\]\(.*?\)\n+", "", text, flags=re.MULTILINE)
    return re.sub(r"\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", text)


def data_files() -> list[tuple[str, list[str]]]:
    """List what goes to `share/`, as pairs of a folder and its files."""
    share = Path("share", NAME)
    placed = {Path("share/ament_index/resource_index/packages"): [f"resource/{NAME}"]}
    placed[share] = ["package.xml"]
    manual = Path("man/cablesense.1")  # `make man` writes it
    if manual.is_file():
        placed[Path("share/man/man1")] = [str(manual)]
    sources = (("config", "config"), ("cablesense_ros/launch", "launch"))
    for source, target in sources:
        for file in sorted(Path(source).rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                folder = share / target / file.parent.relative_to(source)
                placed.setdefault(folder, []).append(str(file))
    return [(str(folder), files) for folder, files in placed.items()]


setup(
    name=NAME,
    version="0.1.0",
    description="From cable tensions: where a cable-driven arm is touched, and how hard",
    long_description=long_description(),
    long_description_content_type="text/markdown",
    keywords="cable-driven continuum robot force estimation contact MuJoCo ROS",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Topic :: Scientific/Engineering",
    ],
    license="Apache-2.0",
    license_files=["LICENSE", "NOTICE"],
    author="CableSense developers",
    maintainer="CableSense developers",
    maintainer_email="cablesense@example.org",
    python_requires=">=3.11,<3.13",
    packages=packages(),
    package_dir=FOLDERS,
    package_data={"": ["*.pyi", "*.html", "*.css", "*.js", "*.json", "*.yaml"]},
    data_files=data_files(),
    install_requires=REQUIRES,
    extras_require=EXTRAS,
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "cablesense = cablesense_ros.cli.app:main",
            "sim = cablesense_ros.programs:sim",
            "estimator = cablesense_ros.programs:estimator",
            "page = cablesense_ros.programs:page",
            "can_driver = cablesense_ros.programs:can_driver",
            "can_emulator = cablesense_ros.programs:can_emulator",
            "breather = cablesense_ros.programs:breather",
            "commissioner = cablesense_ros.programs:commissioner",
        ]
    },
)
