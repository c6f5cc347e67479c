"""Writes the definitions of the packages that are no wheels as files of rosidl: definitions.py SHIPPED FOLDER PACKAGE…"""
import pathlib, sys

shipped, folder, packages = sys.argv[1], sys.argv[2], sys.argv[3:]
target = None
for line in open(shipped, encoding="utf-8"):
    if line.startswith("= "):
        package, kind, name = line[2:].strip().split("/")
        target = None
        if package in packages:
            path = pathlib.Path(folder, package, kind, f"{name}.{kind}")
            path.parent.mkdir(parents=True, exist_ok=True)
            target = open(path, "w", encoding="utf-8")
    elif target and not line.startswith("#"):
        target.write(line)
