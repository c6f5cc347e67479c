#!/usr/bin/env python3
"""Driver of a door, with a clock in place of motors. The messages: docs/reference/driver.md; the actions: docs/devices.md."""
import json, os, select, sys, time

MOVING_S = float(sys.argv[1]) if len(sys.argv) > 1 else 2.0
ACTIONS = {"serve": {"description": "opens the door, and keeps it open", "example": {}}, "alarm": {"description": "keeps a position"}}

# How far the door is open (0 to 1), where it moves, and the goal that wants it there.
opened, target, goal, ending, done, keep_until, reported = 0.0, 0.0, None, False, {}, 0.0, 0.0

def send(kind, **fields):
    print(json.dumps({"type": kind, **fields}), flush=True)

def end(status, **details):
    global goal, ending, done
    done, goal, ending = {"id": goal, "status": status, **details}, None, False
    send("result", **done)

def begin(message):
    global goal, target
    goal, position = message["id"], message.get("parameters", {}).get("position", "open")
    if message["action"] not in ACTIONS: end("aborted", code="unknown", message=f"no action {message['action']}")
    else: target = 1.0 if position == "open" else 0.0

def receive(message):
    global keep_until, ending, target
    kind, id = message["type"], message.get("id")
    if kind == "goal" and done and id == done["id"]: send("result", **done)  # it has ended: do not repeat it
    elif kind == "goal" and goal is None: begin(message)
    if kind in ("goal", "keep") and id == goal: keep_until = time.monotonic() + message["keep_for_ms"] / 1000
    elif kind == "cancel" and id == goal: ending, target = True, 0.0
    elif kind == "heartbeat": send("heartbeat", sequence=message["sequence"])
    elif kind == "shutdown": sys.exit(0)

send("hello", protocol=1, driver="door 1.0", actions=ACTIONS, resumes=False)
rest, data, before = b"", b"\n", time.monotonic()
while data:  # at the end of the input the node has ended
    if select.select([0], [], [], 0.05)[0]:
        data = os.read(0, 65536)
        *lines, rest = (rest + data).split(b"\n")
        for line in filter(bytes.strip, lines):
            try:
                receive(json.loads(line))
            except (ValueError, KeyError, TypeError, AttributeError) as problem:
                send("error", message=f"{type(problem).__name__}: {problem}")
    now = time.monotonic()
    step = (now - before) / MOVING_S
    opened = min(target, opened + step) if opened < target else max(target, opened - step)
    if goal is not None and now >= keep_until: ending, target = True, 0.0  # the permission has passed
    if ending and opened == target: end("canceled")
    if now - reported >= 0.25:
        reported = now
        send("pose", x_m=0.0, y_m=0.0)
        send("charge", share=1.0)
        if goal is not None: send("feedback", id=goal, values={"ready": opened == target and not ending})
    before = now
