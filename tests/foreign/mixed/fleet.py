"""The fleet of the cases: its files, its nodes, and commands that query it."""
import json
import signal

from processes import free_port
from world import CONSORT, Process

FLEET = """
name = "hall"
map = "hall.json"
domains = ["domain.yaml"]
bootstrap_expect = 3
"""

# Places have the coordinates of the vehicle's nodes.
MAP = {
    "name": "hall",
    "places": [{"name": name, "kind": "other", "x_m": x_m, "y_m": y_m}
               for name, x_m, y_m in (("Dock", 0, 0), ("Shelf", 4, 0), ("Ward", 8, 0), ("Bench", 8, 4), ("Gate", 12, 0))],
    "lanes": [{"between": ends} for ends in (["Dock", "Shelf"], ["Shelf", "Ward"], ["Ward", "Bench"], ["Ward", "Gate"])],
}

# No action is repeatable. The readings of the simulated robot count what it has executed.
DOMAIN = """
domain: hall
description: A load passes from a vehicle to a robot with a drawer, and a third robot looks on.
actions:
  pick_load:
    parameters: { load: { type: text } }
  drop_load:
    parameters: { load: { type: text } }
  look:
    feedback: { seen_share: { type: number, minimum: 0, maximum: 1 } }
    simulate: { duration_s: [8, 8], feedback: { seen_share: [0, 1] }, effects: { looks: { add: 1 } } }
  inspect:
    simulate: { duration_s: [2, 2], effects: { inspections: { add: 1 } } }
readings:
  looks: { type: integer, minimum: 0, simulate: { value: 0 } }
  inspections: { type: integer, minimum: 0, simulate: { value: 0 } }
tasks:
  pick_load: { action: pick_load, parameters: { load: { type: text } } }
  drop_load: { action: drop_load, parameters: { load: { type: text } } }
  look: { action: look }
  inspect: { action: inspect }
"""


class Fleet:
    """Three stations and the nodes of robots, each linked with all stations."""

    def __init__(self, world):
        self.world, self.stations = world, {}
        world.file("fleet.toml", FLEET)
        world.file("hall.json", json.dumps(MAP))
        world.file("domain.yaml", DOMAIN)
        self.ports = {name: free_port() for name in ("amber", "birch", "cedar")}
        for name in self.ports:
            others = [other for other in self.ports if other != name]
            self.stations[name] = self.node("station", name, "stationary = true\n", self.ports[name], others)

    def node(self, kind, name, more, port=0, neighbours=None):
        """Starts a node. `more` are the lines of its file before the tables, or before its own tables."""
        addresses = [f"tcp/127.0.0.1:{self.ports[station]}" for station in neighbours or self.ports]
        bus = f'[bus]\nlisten = ["tcp/127.0.0.1:{port}"]\nconnect = {json.dumps(addresses)}\n'
        keys, mark, tables = more.partition("[[")
        self.world.file(f"{name}.toml", f'name = "{name}"\nfleet = "fleet.toml"\n{keys}{bus}{mark}{tables}')
        return Process(self.world, [CONSORT, kind, "--config", f"{name}.toml"])

    def robot(self, name, place, skills, driver=None):
        driver = f"driver = {json.dumps([str(word) for word in driver])}\n" if driver else ""
        return self.node("robot", name, f'place = "{place}"\nskills = {json.dumps(skills)}\nspeed_mps = 0.5\nmay_vote = false\n{driver}')

    def simulated(self, name, place):
        """Starts the world of a simulated robot."""
        return self.node("world", "world", f'[[robot]]\nid = "{name}"\nplace = "{place}"\nspeed_mps = 0.5\nbattery = 0.9\n'
                                           'discharge_share_per_s = 0.0001\n')

    def reach(self):
        """Returns the flags of a command that reaches the fleet through any station that runs."""
        flags = ["--fleet", "hall"]
        for name, station in self.stations.items():
            if station.child.poll() is None:
                flags += ["--connect", f"tcp/127.0.0.1:{self.ports[name]}"]
        return flags

    def json(self, command, *words):
        """Returns the output of a command as JSON, None if it fails."""
        ran = self.world.run(CONSORT, command, *words, *self.reach(), "--json")
        return json.loads(ran.stdout.splitlines()[0]) if ran.returncode == 0 and ran.stdout else None

    def coordinator(self):
        """Returns the name and the term of the coordinator; (None, 0) while there is none."""
        seen = (self.json("fleet") or {}).get("coordinator", {})
        return seen.get("coordinator"), seen.get("term", 0)

    def ready(self, robots):
        """Returns the coordinator as above once the stations vote and the robots are free."""
        seen = self.json("fleet") or {}
        free = {node["node"] for node in seen.get("fleet", {}).get("nodes", [])
                if (node["robot"] or {}).get("availability") == "free" and node["status"] == "alive"}
        coordinator = seen.get("coordinator", {})
        if free >= set(robots) and set(coordinator["voters"]) == set(self.stations) and coordinator["coordinator"]:
            return coordinator["coordinator"], coordinator["term"]
        return None

    def ended(self, mission):
        """Returns the mission once it has ended."""
        seen = self.json("missions", mission)
        return seen if seen and seen["state"] not in ("pending", "running") else None

    def kill(self, station):
        self.stations[station].stop(signal.SIGKILL)
