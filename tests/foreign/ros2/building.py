"""Genuine rclpy nodes that play doors and lifts of Open-RMF: building.py --door NAME --lift NAME=FLOOR,FLOOR.

A door moves for 0.3 s; a lift drives for 0.3 s, and serves a single session. Writes an event as a JSON line for each
request that changes something. A line `mode N` on the input changes the mode of all lifts, as in a fire (3).
"""
import argparse, json, os, sys, threading, time
import rclpy
from rmf_door_msgs.msg import DoorMode, DoorRequest, DoorState
from rmf_lift_msgs.msg import LiftRequest, LiftState

options = argparse.ArgumentParser()
options.add_argument("--door", action="append", default=[])
options.add_argument("--lift", action="append", default=[])
options = options.parse_args()
MOVES_S = 0.3


def event(what, **more):
    print(json.dumps({"event": what, **more}), flush=True)


class Door:
    def __init__(self, name):
        self.name, self.target, self.moved_at = name, 0, 0.0

    def request(self, message):
        mode = message.requested_mode.value
        if message.door_name == self.name and mode != self.target:
            self.target, self.moved_at = mode, time.monotonic()
            event("door", name=self.name, mode=mode, requester=message.requester_id, stamp=message.request_time.sec)

    def state(self):
        moves = time.monotonic() - self.moved_at < MOVES_S
        return DoorState(door_name=self.name, current_mode=DoorMode(value=1 if moves else self.target))


class Lift:
    def __init__(self, text):
        self.name, floors = text.split("=")
        self.floors = floors.split(",")
        self.floor, self.session, self.mode, self.moved_at = self.floors[0], "", 2, 0.0

    def request(self, message):
        if message.lift_name != self.name or self.session not in ("", message.session_id):
            return
        if message.request_type == 0:
            if self.session:
                event("lift_ends", name=self.name, session=self.session)
            self.session = ""
        elif message.destination_floor in self.floors:
            if (self.session, self.floor) != (message.session_id, message.destination_floor):
                event("lift", name=self.name, floor=message.destination_floor, session=message.session_id)
                self.moved_at = time.monotonic()
            self.session, self.floor = message.session_id, message.destination_floor

    def state(self):
        moves = time.monotonic() - self.moved_at < MOVES_S
        return LiftState(lift_name=self.name, available_floors=self.floors, current_floor=self.floor, destination_floor=self.floor,
                         door_state=0 if moves or not self.session else 2, motion_state=1 if moves else 0,
                         available_modes=[1, 2, 3], current_mode=self.mode, session_id=self.session)


rclpy.init()
node = rclpy.create_node("building")
doors, lifts = [Door(name) for name in options.door], [Lift(text) for text in options.lift]
door_states, lift_states = node.create_publisher(DoorState, "/door_states", 10), node.create_publisher(LiftState, "/lift_states", 10)
node.create_subscription(DoorRequest, "/door_requests", lambda message: [door.request(message) for door in doors], 10)
node.create_subscription(LiftRequest, "/lift_requests", lambda message: [lift.request(message) for lift in lifts], 10)


def publish():
    for door in doors:
        door_states.publish(door.state())
    for lift in lifts:
        lift_states.publish(lift.state())


node.create_timer(0.1, publish)
threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
event("ready")
for line in sys.stdin:  # until the case ends
    for lift in lifts:
        lift.mode = int(line.split()[1])
os._exit(0)
