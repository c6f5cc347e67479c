//! Client requests and replies in any language: JSON in, JSON out, on `consort/{fleet}/api/…`.
//!
//! | call | request | reply |
//! |---|---|---|
//! | `submit` | `{"mission": "vital-signs", "parameters": {"room_a": "IC Room 6"}, "request": "my-7"}`; `mission` may also be a whole mission file as an object; optional: `request`, `priority` (-100 to 100, higher is served first, default 0) and `deadline_s` (seconds from now until the mission should be completed) | `{"mission": "vital-signs-1", "again": false}` |
//! | `cancel` | `{"mission": "vital-signs-1", "by": "a clerk"}` | `{"mission": …, "state": …}` |
//! | `cancel_missions` | `{"missions": ["vital-signs-1", "vital-signs-2"], "by": "Nia"}`; `missions` may also be `{"where": "mission.name == \"vital-signs\" && mission.age_s > 3600"}`; optional: `dry_run` (the missions are only listed) | `{"missions": {"vital-signs-1": {"canceled": …}}, "refused": {}, "again": false}` |
//! | `priority` | `{"mission": "vital-signs-1", "priority": 10, "by": "Nia"}`; `priority` is -100 to 100 | `{"mission": …, "priority": 10}` |
//! | `reassign` | `{"mission": "vital-signs-1", "role": "r1", "to": "birch", "by": "Nia"}`; optional: `to`, or instead `pin` (the role gets no other robot) or `unpin`; `repeat` (tasks that have ended may be repeated) | `{"mission": …, "role": …, "phase": …, "robot": …, "order": …}` |
//! | `resolve` | `{"mission": "vital-signs-1", "by": "Nia"}`: the items that the mission left with robots have been taken care of | `{"mission": …, "state": …}` |
//! | `answer` | `{"request": "vital-signs-1.1", "answer": "done", "results": {"dust_g": 3}, "by": "Nia"}`; `answer` may also be `declined`, `cannot` or `later` (with `minutes`); optional: `note` | `{"request": …, "phase": …}` |
//! | `hold` | `{"robots": ["ada"], "for_s": 600, "reason": "a spill", "by": "Nia"}`; `robots` may also be `"all"`, `{"where": "robot.attributes.section == \"icu\""}` or `{"zone": "icu"}`; optional: `for_s` (600), `reason` | `{"robots": {"ada": {"hold": {…}, "maintenance": null}}}` |
//! | `release` | `{"robots": ["ada"], "by": "Nia"}` | as of `hold` |
//! | `maintenance` | `{"robots": ["ada"], "action": "begin", "reason": "new tyres", "by": "Nia"}`; `action` may also be `end`; optional: `until` (RFC 3339) | as of `hold` |
//! | `close` | `{"places": ["IC Room 6"], "lanes": [["IC Corridor 5", "IC Room 5"]], "for_s": 3600, "reason": "wet floor", "by": "Nia"}`; `places` may contain zones; optional: `places` or `lanes`, `for_s` or `until` (RFC 3339), `reason` | `{"closures": […]}`: all that are in force |
//! | `open` | `{"places": ["IC Room 6"], "by": "Nia"}`; optional: `places` or `lanes` | as of `close` |
//! | `limit` | `{"places": ["IC Corridor 5"], "action": "set", "speed_mps": 0.3, "reason": "wet floor", "by": "Nia"}`; `action` may also be `clear`; `places` may contain zones; optional: `places` or `lanes`, `for_s` or `until` (RFC 3339), `reason` | `{"speed_limits": […]}`: all that are in force |
//! | `alarm` | `{"action": "raise", "alarm": "fire", "reason": "smoke", "by": "Nia"}`; `action` may also be `clear`, then without `alarm` for all; optional: `reason` | `{"alarms": […]}`: all that are in force |
//! | `backup` | nothing | a copy of the ledger, with everything acknowledged before the request: with key figures as plain text |
//! | `upgrade` | `{"finish": false}`: the wire versions that each node reads; with `true` the fleet writes the next version from then on | `{"wire": 1, "next": 2, "nodes": […]}` |
//! | `get` | `{"mission": "vital-signs-1"}`; optional: `linearizable` | the mission, as in `view/mission/{id}` |
//! | `list` | nothing, or `{"linearizable": true}` | `{"missions": […]}`, as in `view/missions` |
//! | `requests` | nothing, or `{"linearizable": true}` | `{"requests": […]}`, as in `view/requests` |
//! | `audit` | nothing, or `{"linearizable": true}` | `{"entries": […]}`, as in `view/audit` |
//! | `explain` | `{"mission": "vital-signs-1"}`; optional: `linearizable` | why each robot did or did not get each role |
//! | `help` | nothing | `{"calls": […]}`: all calls, with JSON Schemas; `api/{call}/help` returns a single call |
//!
//! Only the coordinator replies to the calls up to `upgrade`. All of them except `backup` may change state.
//! A request that cannot be executed gets `{"error": "…"}`, and nothing has changed. With an
//! additional `"retry_after_ms"` the same request, with the same `request` id, may be repeated
//! after that time: there is no coordinator yet, or the ledger did not commit in time. The reply to
//! a submission is sent once the mission is committed. Any node replies to the other calls (see
//! [`crate::view`]). A node with too many open requests refuses further ones, by an error reply of Zenoh
//! that begins with `busy`, or in a fleet with certificates by no reply; such a request was not executed
//! and may be repeated.
//!
//! A read is answered from the copy of the nearest node, which may lag behind: `ledger` in the reply
//! states its `revision` and its age. With `"linearizable": true` a majority first confirms the
//! coordinator, and the reply contains everything that was acknowledged before the request; without
//! a majority it is an error with `retry_after_ms`.
//!
//! A repeated `request` id gets the same reply and is not executed again, until a day after the end
//! of the mission; after the end the reply contains its `outcome`. The fleet forgets an outcome
//! sooner only if the outcomes of a day take more than 4 MiB. An id that is a UUID of version 7
//! contains the time at which it was created. It is rejected if it is older than the requests that
//! the fleet remembers, so it is never executed twice. Clients should create such ids.
//!
//! A mission that is not completed by its deadline fails. The coordinators' wall clocks decide
//! about deadlines.

mod help;
mod parse;
mod reply;
mod request;
mod robot_selection;

pub use help::{CallHelp, HelpReply, example, payload_schema};
pub use parse::{RequestError, parse_read_options, parse_request};
pub use reply::{
    AlarmsReply, AnswerReply, CancelMissionsReply, ClosuresReply, ErrorReply, ExplainReply, LimitsReply,
    MissionChangeReply, NodeVersions, OrdersReply, PriorityReply, ReassignReply, ScheduleReply, SubmitReply,
    UninvitedRobot, UpgradeReply,
};
pub use request::{
    AlarmAction, AlarmRequest, AllRobots, AnswerRequest, AnswerWord, CLOSE_S_MAX, CancelMissionsRequest, CloseRequest,
    HOLD_S, HOLD_S_MAX, HoldRequest, LATER_MINUTES_MAX, LimitAction, LimitRequest, MaintenanceAction,
    MaintenanceRequest, MissionChangeRequest, MissionQuery, MissionSelection, MissionSource, OpenRequest,
    PriorityRequest, ReadOptions, ReassignRequest, ReleaseRequest, RobotSelection, RobotZone, SPEED_LIMIT_MIN_MPS,
    ScheduleAction, ScheduleRequest, SelectionCondition, StartTime, SubmitRequest, UpgradeRequest,
};
pub use robot_selection::SelectionError;
