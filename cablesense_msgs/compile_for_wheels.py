"""Makes `cablesense_msgs` for Python where ROS 2 came as wheels, without colcon's ament_cmake.

    python cablesense_msgs/compile_for_wheels.py [FOLDER]

The folder is one of the Python path, by default that of this environment. It needs gcc. The wheels
bring ROS 2's generators, and the headers and libraries that messages are built on.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

NAME = "cablesense_msgs"
BUILT_ON = ("rosidl", "fastcdr", "builtin_interfaces", "geometry_msgs", "std_msgs")


def generate(into: Path) -> None:
    """Write the sources of the message in Python and C."""
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)  # where generators find templates
    from rosidl_adapter.cli import TranslateMsgToIDL
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    package = Path(__file__).resolve().parent
    given: dict[str, Any] = {
        "package_name": NAME,
        "include_paths": [str(Path(sys.prefix, "share"))],
        "output_path": into / NAME,
    }
    files = [f"{package}:{file.relative_to(package)}" for file in package.glob("msg/*.msg")]
    given["interface_files"] = TranslateMsgToIDL("idl").translate(interface_files=files, **given)
    hashes = HashTypeDescription("hash").generate_type_hashes(**given)
    GenerateC("c").generate(**given, type_description_files=hashes)
    GenerateFastRTPSCTypesupport("fastrtps").generate(**given)
    GenerateIntrospectionCTypesupport("introspection").generate(**given)
    GenerateCTypesupport("c").generate(**given)
    GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]).generate(**given)
    (into / NAME / "__init__.py").touch()


def compile_sources(into: Path) -> None:
    """Make the libraries that Fast DDS loads by name, and Python's extension module."""
    import numpy as np

    libraries = Path(sys.prefix, "lib")
    headers = Path(sys.prefix, "include")
    includes = [into, *headers.iterdir(), headers, sysconfig.get_path("include"), np.get_include()]
    used = [
        f"-l:{library.name}"
        for library in sorted(libraries.glob("lib*.so"))
        if library.name.removeprefix("lib").startswith(BUILT_ON) and "_cpp." not in library.name
    ]
    linked = [
        f"-L{into / NAME}",
        f"-L{libraries}",
        f"-Wl,--no-as-needed,-rpath,$ORIGIN:{libraries}",
    ]
    given = ["gcc", "-shared", "-fPIC", "-O2", *(f"-I{folder}" for folder in includes), *linked]
    for library, patterns in {
        f"lib{NAME}__rosidl_generator_c.so": ["detail/*__description.c", "detail/*__functions.c"],
        f"lib{NAME}__rosidl_typesupport_fastrtps_c.so": ["detail/*__type_support_c.cpp"],
        f"lib{NAME}__rosidl_typesupport_introspection_c.so": ["detail/*__type_support.c"],
        f"{NAME}_s__rosidl_typesupport_c.so": ["*__type_support.cpp", "*_s.c", "../*_s.ep.*.c"],
    }.items():
        sources = [file for pattern in patterns for file in (into / NAME / "msg").glob(pattern)]
        linking = [*given, *sources, *used, "-lstdc++", "-o", into / NAME / library]
        subprocess.run(linking, check=True)
        used.append(f"-l:{library}")


if __name__ == "__main__":
    folder = Path(*sys.argv[1:] or [sysconfig.get_path("purelib")]).resolve()
    try:
        generate(folder)
        compile_sources(folder)
    except (ImportError, OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"{NAME} needs gcc, the headers of Python and the extra `ros`: {error}")
