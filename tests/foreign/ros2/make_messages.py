"""Generates messages for rclpy with the rosidl wheels: make_messages.py VENV SOURCES PACKAGE…

SOURCES contains PACKAGE/msg/*.msg, PACKAGE/srv/*.srv and PACKAGE/action/*.action. The libraries and the Python package
are installed into VENV. Only what rmw_zenoh_cpp and rclpy need is generated: C structures, the type support for
fastcdr, and Python. `rosidl generate` cannot be used: its Python extension has two entry points in the wheels.
"""
import os, pathlib, shutil, subprocess, sys, sysconfig
from rosidl_adapter.cli import TranslateActionToIDL, TranslateMsgToIDL, TranslateSrvToIDL
from rosidl_cli.command.helpers import (
    build_type_description_tuples, generate_visibility_control_file, generator_arguments_file, legacy_generator_arguments,
    ros_interface_file_from_idl)
from rosidl_generator_c import generate_c
from rosidl_generator_py import generate_py
from rosidl_generator_type_description.cli import HashTypeDescription
from rosidl_typesupport_c import generate_c as generate_typesupport_c
from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c

venv, sources, packages = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]).resolve(), sys.argv[3:]
site = venv / "lib/python3.11/site-packages"
SUPPORTS = ["rosidl_typesupport_fastrtps_c"]
TRANSLATE = {"msg": TranslateMsgToIDL, "srv": TranslateSrvToIDL, "action": TranslateActionToIDL}


def generate(package, build):
    """Writes the sources of a package below `build / package`."""
    out = build / package
    idl = []
    for kind, translator in TRANSLATE.items():
        files = sorted((sources / package / kind).glob(f"*.{kind}"))
        if files:
            names = [f"{sources / package}:{kind}/{file.name}" for file in files]
            idl += translator(kind).translate(package, names, [], out)
    share = [str(venv / "share"), str(build)]
    hashes = HashTypeDescription("x").generate_type_hashes(package, idl, share, out)

    def templates(generator):
        return venv / "share" / generator / "resource"

    def arguments(generator, **more):
        return generator_arguments_file(
            **legacy_generator_arguments(package_name=package, interface_files=idl, include_paths=share,
                                         templates_path=templates(generator), output_path=out), **more)

    for generator in ("rosidl_generator_c", "rosidl_typesupport_fastrtps_c"):
        header = f"{generator}__visibility_control.h"
        generate_visibility_control_file(package_name=package, template_path=templates(generator) / f"{header}.in",
                                         output_path=out / "msg" / header)
    described = {"type_description_tuples": build_type_description_tuples(idl, hashes),
                 "ros_interface_files": [str(ros_interface_file_from_idl(file)) for file in idl]}
    with arguments("rosidl_generator_c", **described) as file:
        generate_c(file)
    with arguments("rosidl_typesupport_fastrtps_c") as file:
        generate_typesupport_fastrtps_c(file)
    with arguments("rosidl_typesupport_c") as file:
        generate_typesupport_c(file, SUPPORTS)
    with arguments("rosidl_generator_py") as file:
        generate_py(file, ["rosidl_typesupport_c"])
    return out


def compile_package(package, out, build):
    """Compiles the sources, and installs libraries and Python package."""
    includes = [f"-I{build}", f"-I{sysconfig.get_path('include')}", f"-I{site}/numpy/_core/include"]
    for folder in sorted((venv / "include").iterdir()):
        includes.append(f"-I{folder}")
    includes.append(f"-I{venv}/include")
    flags = ["-shared", "-fPIC", "-O0", "-w", *includes, f"-L{venv}/lib", "-Wl,--allow-shlib-undefined", "-Wl,-z,lazy"]
    groups = {
        f"lib{package}__rosidl_generator_c": [*out.glob("*/detail/*__functions.c"), *out.glob("*/detail/*__description.c"),
                                              *out.glob("*/detail/*__type_support.c")],
        f"lib{package}__rosidl_typesupport_fastrtps_c": [*out.glob("*/detail/*__type_support_c.cpp")],
        f"lib{package}__rosidl_typesupport_c": [*out.glob("*/*__type_support_c.cpp"), *out.glob("*/*__type_support.cpp"),
                                                *out.glob("*/*__type_support.c")],
        f"lib{package}__rosidl_generator_py": [*out.glob("*/_*_s.c")],
    }
    before = []
    # The libraries of other packages, of which the linker keeps those that are needed.
    suffixes = ["generator_c", "typesupport_fastrtps_c", "typesupport_c", "generator_py"]
    others = [file for suffix in suffixes for file in sorted((venv / "lib").glob(f"lib*_msgs__rosidl_{suffix}.so"))
              + sorted((venv / "lib").glob(f"libbuiltin_interfaces__rosidl_{suffix}.so"))]
    runtime = ["librosidl_runtime_c.so", "librcutils.so", "librosidl_typesupport_c.so",
               "librosidl_typesupport_fastrtps_c.so", "libfastcdr.so"]
    libraries = ["-Wl,--as-needed", *(f"-l:{file.name}" for file in others if f"lib{package}__" not in file.name),
                 *(f"-l:{name}" for name in runtime)]
    for name, files in groups.items():
        compiler = "g++" if any(file.suffix == ".cpp" for file in files) else "gcc"
        target = venv / "lib" / f"{name}.so"
        subprocess.run([compiler, *map(str, files), *flags, *before, *libraries, "-o", str(target)], check=True)
        before.append(f"-l:{target.name}")
    shutil.rmtree(site / package, ignore_errors=True)
    (site / package).mkdir()
    for file in out.glob("**/*.py"):
        to = site / package / file.relative_to(out)
        to.parent.mkdir(exist_ok=True)
        shutil.copy(file, to)
    (site / package / "__init__.py").touch()
    entry = out / f"_{package}_s.ep.rosidl_typesupport_c.c"
    target = site / package / f"{package}_s__rosidl_typesupport_c.so"
    subprocess.run(["gcc", str(entry), *flags, *before, *libraries, "-o", str(target)], check=True)
    for kind in TRANSLATE:
        for file in out.glob(f"{kind}/*.idl"):
            to = venv / "share" / package / kind / file.name
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, to)


build = pathlib.Path(os.environ.get("TMPDIR", "/tmp")) / f"messages-{os.getpid()}"
for package in packages:
    compile_package(package, generate(package, build), build)
shutil.rmtree(build)
