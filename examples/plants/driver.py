#!/usr/bin/env python3
"""Driver of a robot that waters plants, with a clock in place of motors. The messages: docs/reference/driver.md."""
import json, math, os, select, sys, time

SPEED_MPS = float(sys.argv[1]) if len(sys.argv) > 1 else 0.5
LITRES = {"description": "waters the plant", "parameters": {"litres": {"type": "number"}}, "example": {"litres": 1.0}}
ACTIONS = {"navigate_to_pose": {"description": "drives in a straight line"}, "inspect_plant": {}, "water": LITRES}

at = target = (0.0, 0.0)
goal, done, ends, keep_until, reported = None, {}, 0.0, 0.0, 0.0

def send(kind, **fields):
    print(json.dumps({"type": kind, **fields}), flush=True)

def end(status, **details):
    global goal, done
    goal, done = None, {"id": goal, "status": status, **details}
    send("pose", x_m=at[0], y_m=at[1])
    send("result", **done)

def begin(message):
    global goal, target, ends
    goal, target, action, parameters = message["id"], at, message["action"], message.get("parameters", {})
    try:
        seconds = {"navigate_to_pose": lambda: 0.0, "inspect_plant": lambda: 1.0, "water": lambda: 2.0 * float(parameters["litres"])}[action]()
        if action == "navigate_to_pose":
            target = float(parameters["pose"]["x_m"]), float(parameters["pose"]["y_m"])
        ends = time.monotonic() + math.dist(at, target) / SPEED_MPS + seconds
    except (ValueError, KeyError, TypeError) as problem:
        end("aborted", code="unknown", message=f"{action}: {problem!r}")

def receive(message):
    global at, keep_until
    kind, id = message["type"], message.get("id")
    if kind == "start": at = message["pose"]["x_m"], message["pose"]["y_m"]
    elif kind == "goal" and done and id == done["id"]: send("result", **done)  # it has ended: do not repeat it
    elif kind == "goal" and goal is None: begin(message)
    if kind in ("goal", "keep") and id == goal: keep_until = time.monotonic() + message["keep_for_ms"] / 1000
    elif kind == "cancel" and id == goal: end("canceled")
    elif kind == "heartbeat": send("heartbeat", sequence=message["sequence"])
    elif kind == "shutdown": sys.exit(0)

send("hello", protocol=1, driver="gardener 1.0", actions=ACTIONS, resumes=True)
rest, data, before = b"", b"\n", time.monotonic()
while data:  # at the end of the input the node has ended, and the robot stops
    if select.select([0], [], [], 0.05)[0]:
        data = os.read(0, 65536)
        *lines, rest = (rest + data).split(b"\n")
        for line in filter(bytes.strip, lines):
            try:
                receive(json.loads(line))
            except (ValueError, KeyError, TypeError, AttributeError) as problem:
                send("error", message=f"{type(problem).__name__}: {problem}")
    now = time.monotonic()
    if goal is not None:
        left = math.dist(at, target)
        part = min(1.0, SPEED_MPS * (now - before) / left) if left else 1.0
        at = tuple(own + part * (to - own) for own, to in zip(at, target))
        if now >= keep_until: end("canceled")  # the permission has passed
        elif now >= ends and at == target: end("succeeded")
    if now - reported >= 0.5:
        reported = now
        send("pose", x_m=at[0], y_m=at[1])
        send("charge", share=1.0)
        if goal is not None: send("feedback", id=goal, distance_remaining_m=math.dist(at, target))
    before = now
