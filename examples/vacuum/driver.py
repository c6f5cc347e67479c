#!/usr/bin/env python3
"""Driver of a simulated vacuum cleaner. JSON lines on the standard streams: docs/reference/driver.md."""
import json, math, os, select, sys, time

SPEED_MPS = float(sys.argv[1]) if len(sys.argv) > 1 else 0.5
VACUUM = {"description": "cleans the room", "parameters": {"passes": {"type": "integer"}},
          "results": {"dust_g": {"type": "number"}}, "example": {"passes": 1}}
ACTIONS = {"navigate_to_pose": {"description": "drives in a straight line"}, "vacuum": VACUUM, "empty_bag": {}}

def send(kind, **fields):
    print(json.dumps({"type": kind, **fields}), flush=True)

class Vacuum:
    def __init__(self):
        self.at, self.charge, self.dust, self.goal, self.last = (0.0, 0.0), 1.0, 0.0, None, {}
        self.time = self.reported = time.monotonic()

    def receive(self, line):
        try:
            message = json.loads(line)
            self.handle(message["type"], message, message.get("id", ""))
        except (ValueError, KeyError, TypeError, AttributeError) as problem:
            send("error", message=f"{type(problem).__name__}: {problem}")

    def handle(self, kind, message, id):
        if kind == "start":
            self.at = message["pose"]["x_m"], message["pose"]["y_m"]
            self.report()
        elif kind == "goal" and id == self.last.get("id"):  # it has ended: do not repeat it
            send("result", **self.last)
        elif kind == "goal" and self.goal is None:
            self.begin(id, message["action"], message.get("parameters", {}))
        if kind in ("goal", "keep") and id == self.goal:
            self.keep_until = time.monotonic() + message["keep_for_ms"] / 1000
        elif kind == "cancel" and id == self.goal: self.end("canceled")
        elif kind == "heartbeat": send("heartbeat", sequence=message["sequence"])
        elif kind == "shutdown": sys.exit(0)

    def begin(self, id, action, parameters):
        try:
            pose = parameters["pose"] if action == "navigate_to_pose" else {"x_m": self.at[0], "y_m": self.at[1]}
            work_s = {"navigate_to_pose": lambda: 0.0, "empty_bag": lambda: 1.0, "vacuum": lambda: 2.0 * int(parameters["passes"])}[action]()
            self.dust_gps = {"vacuum": 1.0, "empty_bag": -100.0}.get(action, 0.0)
            self.target, self.work_s, self.goal, self.before = (float(pose["x_m"]), float(pose["y_m"])), work_s, id, self.dust
        except (ValueError, KeyError, TypeError) as problem:
            send("result", id=id, status="aborted", code="unknown", message=f"{action}: {problem!r}")

    def end(self, status, **results):
        self.last, self.goal = {"id": self.goal, "status": status, "results": results}, None
        self.report()
        send("result", **self.last)

    def report(self):
        self.reported = time.monotonic()
        send("pose", x_m=self.at[0], y_m=self.at[1])
        send("charge", share=round(max(self.charge, 0.0), 4))
        send("readings", values={"bag_g": round(self.dust, 2)})
        if self.goal: send("feedback", id=self.goal, distance_remaining_m=math.dist(self.at, self.target))

    def step(self, now):
        elapsed, self.time = now - self.time, now
        if self.goal and now >= self.keep_until:  # the permission has passed
            self.end("canceled")
        elif self.goal:
            left, drive = math.dist(self.at, self.target), SPEED_MPS * elapsed
            part = 1.0 if left <= drive else drive / left
            self.at = tuple(own + part * (to - own) for own, to in zip(self.at, self.target))
            self.work_s, self.charge, self.dust = self.work_s - elapsed, self.charge - 1e-4 * elapsed, max(self.dust + self.dust_gps * elapsed, 0.0)
            if part == 1.0 and self.work_s <= 0: self.end("succeeded", dust_g=round(self.dust - self.before, 2))
        if now - self.reported >= 0.5: self.report()

vacuum, rest, data = Vacuum(), b"", b"\n"
send("hello", protocol=1, driver="vacuum 1.0", actions=ACTIONS, resumes=True)
while data:  # at the end of the input the node has ended, and the robot stops
    if select.select([0], [], [], 0.05)[0]:
        data = os.read(0, 65536)
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            vacuum.receive(line)
    vacuum.step(time.monotonic())
