"""A client of a fleet that uses only the library eclipse-zenoh.

It queries views, requests a mission, and follows the mission to its end.

    python follow.py tcp/127.0.0.1:7447 FLEET

Prints a line per step; after `running` the test may kill the coordinator.
"""

import json
import queue
import sys
import time

import zenoh

ADDRESS, FLEET = sys.argv[1:3]
LIMIT = 90.0


def report(*words):
    print(*words, flush=True)


def until(condition, check):
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        found = check()
        if found:
            return found
        time.sleep(0.05)
    sys.exit(f"not within {LIMIT} s: {condition}")


config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([ADDRESS]))
with zenoh.open(config) as session:
    base = f"consort/{FLEET}"

    def get(key, payload=None):
        """Returns the replies by key, with the default settings of Zenoh."""
        replies = {}
        for reply in session.get(f"{base}/{key}", payload=payload):
            if reply.ok:
                name = str(reply.ok.key_expr).removeprefix(base + "/")
                assert name not in replies, f"{name} has two replies"
                assert reply.ok.encoding == zenoh.Encoding.APPLICATION_JSON, reply.ok.encoding
                replies[name] = json.loads(reply.ok.payload.to_string())
        return replies

    def view(name):
        return get(f"view/{name}").get(f"view/{name}")

    def request(call, **payload):
        """Repeats a request until it is acknowledged. Its name prevents a second execution."""

        def acknowledged():
            reply = get(f"api/{call}", json.dumps(payload)).get(f"api/{call}")
            return reply if reply and "retry_after_ms" not in reply else None

        return until(f"a reply to {call}", acknowledged)

    events = queue.Queue()
    subscriber = session.declare_subscriber(f"{base}/events/**", events.put)

    coordinator = until("a coordinator", lambda: (view("coordinator") or {}).get("node"))
    until("two members", lambda: len(view("ensembles")["ensembles"][0]["members"]) == 2)
    tokens = [str(token.ok.key_expr) for token in session.liveliness().get(f"{base}/alive/**") if token.ok]
    assert any(token.startswith(f"{base}/alive/coordinator/") and token.endswith(coordinator) for token in tokens), tokens
    assert f"{base}/alive/robot/ada" in tokens, tokens
    views = get("view/**")
    names = ["auctions", "coordinator", "ensembles", "fleet", "health", "map", "missions", "world"]
    assert all(f"view/{name}" in views for name in names), views.keys()
    assert all("seen_by" in view and "age_ms" in view for view in views.values())
    report("coordinator", coordinator)

    help = {call["call"]: call for call in get("api/help")["api/help"]["calls"]}
    assert help["submit"]["payload_schema"]["required"] == ["mission"], help["submit"]
    rejected = request("submit", mission="lab-samples", priority="high")
    assert rejected["error"].startswith("priority is a string; allowed is integer"), rejected
    order = {"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "python-1"}
    mission = request("submit", **order)["mission"]
    report("mission", mission)
    until("the mission runs", lambda: request("get", mission=mission)["state"] == "running")
    report("running")

    # Events and views continue without the coordinator.
    last = {}
    state, elected, slowest = None, None, 0.0
    end = time.monotonic() + LIMIT
    while state != "completed":
        assert time.monotonic() < end, f"{mission} is {state}"
        began = time.monotonic()
        missions = view("missions")
        slowest = max(slowest, time.monotonic() - began)
        assert missions and missions["missions"][0]["mission"] == mission, missions
        while not events.empty():
            sample = events.get()
            event = json.loads(sample.payload.to_string())
            assert str(sample.key_expr) == f"{base}/events/{event['node']}", sample.key_expr
            assert event["sequence"] == last.get(event["node"], event["sequence"] - 1) + 1, f"a gap: {event}"
            last[event["node"]] = event["sequence"]
            if event["event"] == "elected" and event["node"] != coordinator:
                elected = event["node"]
            if event["event"] == "mission" and event["mission"] == mission:
                state = event["state"]
        time.sleep(0.05)
    assert request("submit", **order) == {"mission": mission, "again": True, "outcome": "completed"}
    assert request("get", mission=mission)["tree"]["state"] == "done"
    for line in request("explain", mission=mission)["text"]:
        report("explain", line)
    assert elected, "no successor was elected"
    assert slowest < 5.0, f"a view took {slowest} s"
    report("completed", elected)
