"""Writes the definitions of nav2_msgs and tf2_msgs as files of rosidl: definitions.py SHIPPED FOLDER."""
import pathlib, sys

# The further actions of Nav2 are as long to compile, and no case needs them.
UNUSED = {"NavigateThroughPoses", "BackUp", "UndockRobot"}
target = None
for line in open(sys.argv[1], encoding="utf-8"):
    if line.startswith("= "):
        package, kind, name = line[2:].strip().split("/")
        target = None
        if package in ("nav2_msgs", "tf2_msgs") and name not in UNUSED:
            path = pathlib.Path(sys.argv[2], package, kind, f"{name}.{kind}")
            path.parent.mkdir(parents=True, exist_ok=True)
            target = open(path, "w", encoding="utf-8")
    elif target and not line.startswith("#"):
        target.write(line)
