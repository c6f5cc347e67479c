"""Brokers, vehicles and drivers for the cases: each a process of its own."""
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "common"))
from processes import free_port, is_listening, wait_for


class Process:
    """A child process that ends with its case, and so do its own children."""

    def __init__(self, command, log, **options):
        self.log = open(log, "ab")
        self.child = subprocess.Popen([str(word) for word in command], stderr=self.log, start_new_session=True, **options)

    def kill(self, number=signal.SIGKILL):
        if self.child.poll() is None:
            self.child.send_signal(signal.SIGCONT)
            self.child.send_signal(number)
        self.child.wait(10)
        try:
            os.killpg(self.child.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass  # it has left no process
        self.log.close()


class Broker:
    """mosquitto, with the lines of a configuration."""

    def __init__(self, folder, lines=("allow_anonymous true",), port=None, scheme="mqtt"):
        self.folder, self.port, self.scheme = folder, port or free_port(), scheme
        self.file = folder / "mosquitto.conf"
        self.file.write_text("\n".join([f"listener {self.port} 127.0.0.1", "log_type all", "user root", *lines]) + "\n")
        self.start()

    @property
    def url(self):
        return f"{self.scheme}://127.0.0.1:{self.port}"

    def start(self):
        self.process = Process(["mosquitto", "-c", self.file], self.folder / "broker.log", stdout=subprocess.DEVNULL)
        wait_for("the broker listens", lambda: is_listening(self.port), 10)

    def kill(self):
        self.process.kill()

    def text(self):
        return (self.folder / "broker.log").read_text(errors="replace")


class Listener:
    """Records every message on the broker, and publishes."""

    def __init__(self, broker):
        self.messages = []
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self.client.on_connect = lambda client, *_: client.subscribe("#")
        self.client.on_message = lambda _client, _data, message: self.messages.append((message.topic, message.payload))
        self.client.reconnect_delay_set(1, 1)
        self.client.connect("127.0.0.1", broker.port)
        self.client.loop_start()
        wait_for("the listener is connected", self.client.is_connected, 10)

    def of(self, level, serial=None):
        return [json.loads(payload) for topic, payload in list(self.messages)
                if topic.endswith(f"/{level}") and (serial is None or f"/{serial}/" in topic)]

    def kill(self):
        self.client.loop_stop()
        self.client.disconnect()


class Driver:
    """The program under test, with the node's side of its standard streams."""

    def __init__(self, program, file, log):
        self.lines, self.all, self.errors = queue.Queue(), [], log
        self.process = Process([program, "driver", file], log, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        threading.Thread(target=self.read, daemon=True).start()
        self.goal_id = None
        threading.Thread(target=self.keep, daemon=True).start()
        self.wait("hello")
        self.send("start", protocol=1, robot="carrier", place="Dock", pose={"x_m": 0, "y_m": 0, "yaw_rad": 0})

    def read(self):
        for line in self.process.child.stdout:
            message = json.loads(line)
            self.all.append(message)

    def keep(self):
        """Renews the permission of the goal, as a node does."""
        while self.process.child.poll() is None:
            if self.goal_id:
                self.send("keep", id=self.goal_id, keep_for_ms=900)
            time.sleep(0.3)

    def send(self, kind, **fields):
        try:
            self.process.child.stdin.write((json.dumps({"type": kind, **fields}) + "\n").encode())
        except (BrokenPipeError, ValueError):
            pass

    def goal(self, id, action, resumed=False, since=None, **parameters):
        earlier = {} if since is None else {"since": str(since)}
        self.send("goal", id=str(id), action=action, parameters=parameters, keep_for_ms=900, resumed=resumed, **earlier)
        self.goal_id = str(id)

    def drive(self, id, place, resumed=False):
        x_m = {"Dock": 0.0, "Shelf": 4.0, "Ward": 8.0}[place]
        self.goal(id, "navigate_to_pose", resumed, place=place, pose={"x_m": x_m, "y_m": 0.0, "yaw_rad": 0.0})

    def wait(self, kind, limit_s=30.0, **fields):
        def found():
            return next((message for message in self.all if message["type"] == kind
                         and all(message.get(key) == value for key, value in fields.items())), None)
        return wait_for(f"{kind} {fields}, after {self.all[-3:]}", found, limit_s)

    def result(self, id, status="succeeded", limit_s=40.0):
        result = self.wait("result", limit_s, id=str(id))
        assert result["status"] == status, result
        return result

    def kill(self, number=signal.SIGKILL):
        self.goal_id = None
        self.process.kill(number)


class Case:
    """A folder, and what has to end with the case."""

    def __init__(self, program, kit, folder):
        self.program, self.kit, self.folder, self.open = str(Path(program).resolve()), Path(kit).resolve(), folder, []

    def keep(self, part):
        self.open.append(part)
        return part

    def broker(self, *arguments, **options):
        return self.keep(Broker(self.folder, *arguments, **options))

    def listener(self, broker):
        return self.keep(Listener(broker))

    def started(self, command, name):
        process = self.keep(Process(command, self.folder / f"{name}.log", stdout=subprocess.PIPE))
        line = process.child.stdout.readline()
        assert b"started" in line, f"{name} did not start: {(self.folder / f'{name}.log').read_text()[-500:]}"
        return process

    def agv(self, broker, count=1, speed=2.0):
        url = getattr(broker, "url", broker)
        return self.started(["node", HERE / "agv.js", self.kit, url, count, speed], "agv")

    def sdk_vehicle(self, broker):
        return self.started([sys.executable, HERE / "sdk_vehicle.py", broker.url], "sdk")

    # Places of the simulated vehicles: a node has the name of its place.
    PLACES = {"Dock": {"node": "Dock", "x_m": 0, "y_m": 0}, "Shelf": {"node": "Shelf", "x_m": 4, "y_m": 0},
              "Ward": {"node": "Ward", "x_m": 8, "y_m": 0}}

    def vehicles(self, broker, version="2.0"):
        """Simulated vehicles of the program under test."""
        places = [{"name": name, "kind": "other", "x_m": place["x_m"], "y_m": place["y_m"]} for name, place in self.PLACES.items()]
        lanes = [{"between": ["Dock", "Shelf"]}, {"between": ["Shelf", "Ward"]}]
        (self.folder / "hall.json").write_text(json.dumps({"name": "hall", "places": places, "lanes": lanes}))
        content = {"broker": {"url": broker.url}, "version": version, "manufacturer": "Consort", "map": "hall.json",
                   "robots": [{"id": "ada", "place": "Dock", "speed_mps": 2.0, "battery": 1.0, "discharge_share_per_s": 0.0001}],
                   "actions": {"pick": {"action": "wait", "parameters": {"time": 1}}}}
        file = self.folder / "vehicles.yaml"
        file.write_text(json.dumps(content))  # JSON is YAML
        return self.keep(Process([self.program, "vehicles", file], self.folder / "vehicles.log", stdout=subprocess.DEVNULL))

    def official_schemas(self, tag):
        """The folder of the official schemas of a release; None if it cannot be had."""
        if folder := os.environ.get("CONSORT_VDA5050_SCHEMAS"):
            return Path(folder)
        clone = self.kit / f"VDA5050-{tag}"
        if not clone.exists():
            command = ["git", "clone", "--quiet", "--depth", "1", "--branch", tag, "https://github.com/VDA5050/VDA5050", clone]
            try:
                subprocess.run(command, check=True, capture_output=True, timeout=60, env={**os.environ, "GIT_TERMINAL_PROMPT": "0"})
            except (OSError, subprocess.SubprocessError):
                shutil.rmtree(clone, ignore_errors=True)  # git may leave an incomplete folder
                return None
        return clone / "json_schemas"

    def file(self, broker, serial="agv-1", version="2.0", name=None, **more):
        url = getattr(broker, "url", broker)
        content = {
            "broker": {"url": url, **more.pop("access", {})}, "version": version, "manufacturer": "Foreign",
            "serial": serial, "map": "hall", "release_ahead": 1,
            "places": {"Dock": {"node": "n1", "x_m": 0, "y_m": 0}, "Shelf": {"node": "n2", "x_m": 4, "y_m": 0},
                       "Ward": {"node": "n3", "x_m": 8, "y_m": 0}},
            "edges": [["n1", "n2"], ["n2", "n3"]],
            "actions": {
                "pick_load": {"type": "pick", "blocking": "HARD", "result": "load",
                              "parameters": {"stationType": "floor", "loadType": "EPAL", "loadId": "{load}", "duration": 1}},
                "drop_load": {"type": "drop", "blocking": "HARD",
                              "parameters": {"stationType": "floor", "loadType": "EPAL", "loadId": "{load}", "duration": 1}},
                "dock": {"type": "startCharging", "scope": "instant", "blocking": "HARD"},
                "undock": {"type": "stopCharging", "scope": "instant", "blocking": "HARD"},
                "pause": {"type": "startPause", "scope": "instant", "blocking": "HARD"},
                "resume": {"type": "stopPause", "scope": "instant", "blocking": "HARD"},
            }, **more}
        path = self.folder / f"{name or serial}.yaml"
        path.write_text(json.dumps(content))  # JSON is YAML
        return path

    def driver(self, broker, serial="agv-1", **options):
        file = self.file(broker, serial, **options)
        return self.keep(Driver(self.program, file, self.folder / f"driver-{serial}.log"))

    def close(self):
        for part in reversed(self.open):
            try:
                part.kill()
            except (OSError, ValueError, subprocess.TimeoutExpired):
                pass
