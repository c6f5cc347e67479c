"""The router of ROS 2, rclpy nodes, drivers and programs of a case: each a process of its own."""
import json, os, pathlib, queue, signal, subprocess, sys, threading, time

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "common"))
from processes import free_port, is_listening, wait_for
from suite import Failed

V, CONSORT, ROS2 = (os.environ.get(name, "") for name in ("V", "CONSORT", "CONSORT_ROS2"))
LIMIT = 40.0


def is_event(kind, **fields):
    return lambda event: event["event"] == kind and all(event.get(key) == value for key, value in fields.items())


class Process:
    """A process whose lines are read; killed at the end of the case."""

    def __init__(self, world, words, env=None, stdin=True):
        self.words = words
        self.log = open(world.folder / f"{len(world.processes)}-{pathlib.Path(words[0]).name}.log", "w+", encoding="utf-8")
        self.child = subprocess.Popen(words, stdin=subprocess.PIPE if stdin else subprocess.DEVNULL, stdout=subprocess.PIPE,
                                      stderr=self.log, text=True, env={**world.env, **(env or {})}, cwd=world.folder)
        self.lines, self.seen = queue.Queue(), []
        threading.Thread(target=self.read, daemon=True).start()
        world.processes.append(self)

    def read(self):
        for line in self.child.stdout:
            self.lines.put(line)
        self.lines.put(None)

    def next(self, limit):
        line = self.lines.get(timeout=max(limit, 0.01))
        if line is None:
            self.lines.put(None)
            raise Failed(f"{self.words[0]} has ended: {self.errors()[-400:]}")
        return line

    def errors(self):
        return pathlib.Path(self.log.name).read_text(encoding="utf-8")

    def message(self, what, fits, limit=LIMIT):
        """Returns the next JSON line that fits."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            try:
                line = self.next(end - time.monotonic())
            except queue.Empty:
                break
            try:
                message = json.loads(line)
            except ValueError:
                # The Zenoh library of rmw_zenoh logs to the standard output. A driver writes messages only.
                if self.words[0] == ROS2:
                    raise Failed(f"no JSON: {line!r}") from None
                continue
            self.seen.append(message)
            if fits(message):
                return message
        raise Failed(f"not within {limit:.0f} s: {what}; the last lines are {self.seen[-3:]}; {self.errors()[-300:]}")

    def all(self):
        """Returns the JSON lines until now."""
        while not self.lines.empty() and (line := self.next(1.0)):
            self.seen.append(json.loads(line))
        return self.seen

    def send(self, kind, **fields):
        self.child.stdin.write(json.dumps({"type": kind, **fields}) + "\n")
        self.child.stdin.flush()

    def stop(self, sign=signal.SIGTERM):
        self.child.send_signal(sign)
        return self.child.wait(timeout=10)


class World:
    """The router, the processes and the files of a case."""

    def __init__(self, folder):
        self.folder, self.processes, self.port = folder, [], free_port()
        self.env = {**os.environ, "CONSORT_ROS_ROUTER": f"tcp/127.0.0.1:{self.port}", "ROS_DOMAIN_ID": "0"}
        self.env.pop("RUST_LOG", None)
        listen = f'listen/endpoints=["tcp/127.0.0.1:{self.port}"]'
        self.router = Process(self, [f"{V}/lib/rmw_zenoh_cpp/rmw_zenohd"], {"ZENOH_CONFIG_OVERRIDE": listen}, stdin=False)
        wait_for("the router listens", lambda: is_listening(self.port), LIMIT)

    def ros(self, script, *arguments):
        connect = f'connect/endpoints=["tcp/127.0.0.1:{self.port}"]'
        return Process(self, [f"{V}/bin/python", str(HERE / script), *arguments],
                       {"ZENOH_CONFIG_OVERRIDE": connect, "LD_PRELOAD": os.environ["ROS_PRELOAD"]})

    def robot(self, *arguments, script="robot.py"):
        robot = self.ros(script, *arguments)
        robot.message("the robot is ready", is_event("ready"))
        return robot

    def file(self, name, text):
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return str(path)

    def run(self, *words, limit=LIMIT):
        return subprocess.run(words, capture_output=True, text=True, timeout=limit, env=self.env, cwd=self.folder)

    def driver(self, file, robot="ada"):
        return Driver(self, file, robot)

    def close(self):
        for process in reversed(self.processes):
            process.child.kill()
            process.child.wait()


class Driver(Process):
    """`consort-ros2 driver` as its node sees it."""

    def __init__(self, world, file, robot):
        super().__init__(world, [ROS2, "driver", file])
        self.send("start", protocol=1, robot=robot, place="Dock", pose={"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0})
        self.hello = self.message("the hello", lambda message: message["type"] == "hello")

    def goal(self, id, action, /, resumed=False, keep_for_ms=600000, **parameters):
        self.send("goal", id=str(id), action=action, parameters=parameters, keep_for_ms=keep_for_ms, resumed=resumed)

    def result(self, id, limit=LIMIT):
        return self.message(f"the result of {id}", lambda sent: sent["type"] == "result" and sent["id"] == str(id), limit)

    def ready(self, id, is_ready):
        self.message(f"ready is {is_ready}", lambda sent: sent["type"] == "feedback" and sent["id"] == str(id)
                     and sent["values"] == {"ready": is_ready})

    def do(self, id, action, /, **parameters):
        self.goal(id, action, **parameters)
        return self.result(id)
