//! Decorators: one child, and a change to what it answers or how often it is asked.

use super::node::{Node, Slot};
use super::ports::{PortError, Ports};
use super::status::Status;
use super::tick::{Cause, Tick};
use super::value::Value;
use consort_protocol::units::{Seconds, WorldTime};
use std::collections::VecDeque;

/// `Inverter`, `ForceSuccess`, `ForceFailure`: the child's final answer, mapped.
pub(crate) struct Mapped {
    child: Slot,
    map: fn(Status) -> Status,
}

impl Mapped {
    pub(crate) fn inverter(child: Slot) -> Mapped {
        let map = |status| match status {
            Status::Success => Status::Failure,
            Status::Failure => Status::Success,
            Status::Running => Status::Running,
        };
        Mapped { child, map }
    }

    pub(crate) fn force(child: Slot, to: Status) -> Mapped {
        let map = match to {
            Status::Success => |status: Status| if status.is_final() { Status::Success } else { status },
            _ => |status: Status| if status.is_final() { Status::Failure } else { status },
        };
        Mapped { child, map }
    }
}

impl Node for Mapped {
    fn tick(&mut self, tick: &mut Tick<'_>) -> Status {
        (self.map)(self.child.tick(tick))
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
    }
}

/// `RetryUntilSuccessful` and `Repeat`: the child again and again while it answers `again`, up to a number of times of
/// which -1 is without end. All turns may fall into one tick; one without end takes one turn a tick.
pub(crate) struct Again {
    child: Slot,
    ports: Ports,
    count: &'static str,
    again: Status,
    turns: i64,
}

impl Again {
    /// Until the child succeeds; fails when `num_attempts` have failed.
    pub(crate) fn retry(ports: Ports, child: Slot) -> Again {
        Again { child, ports, count: "num_attempts", again: Status::Failure, turns: 0 }
    }

    /// Succeeds when the child did `num_cycles` times; fails when it fails.
    pub(crate) fn repeat(ports: Ports, child: Slot) -> Again {
        Again { child, ports, count: "num_cycles", again: Status::Success, turns: 0 }
    }

    fn end(&mut self, status: Status) -> Status {
        self.turns = 0;
        status
    }
}

impl Node for Again {
    fn tick(&mut self, tick: &mut Tick<'_>) -> Status {
        let limit: i64 = match self.ports.read(tick.blackboard, self.count) {
            Ok(limit) => limit,
            Err(error) => return self.refuse(tick, error),
        };
        while limit < 0 || self.turns < limit {
            if !self.child.is_running() && !tick.take_turn() {
                return Status::Running;
            }
            match self.child.tick(tick) {
                Status::Running => return Status::Running,
                status if status == self.again => self.turns = self.turns.saturating_add(1),
                status => return self.end(status),
            }
            if limit < 0 {
                tick.wake_at(tick.now);
                return Status::Running;
            }
        }
        self.end(self.again)
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.turns = 0;
    }
}

impl Again {
    fn refuse(&mut self, tick: &mut Tick<'_>, error: PortError) -> Status {
        self.child.halt(tick);
        tick.fail(if self.again == Status::Failure { "RetryUntilSuccessful" } else { "Repeat" }, Cause::from(error));
        self.end(Status::Failure)
    }
}

/// `Timeout`: fails, and halts its child, when the child is still running `msec` milliseconds of world time after it
/// began; 0 is no limit.
pub(crate) struct Timeout {
    child: Slot,
    ports: Ports,
    deadline: Option<WorldTime>,
    began: bool,
}

impl Timeout {
    pub(crate) fn new(ports: Ports, child: Slot) -> Timeout {
        Timeout { child, ports, deadline: None, began: false }
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<(), PortError> {
        let msec: i64 = self.ports.read(tick.blackboard, "msec")?;
        let time = Seconds::new(msec as f64 / 1000.0).unwrap_or(Seconds::ZERO);
        self.deadline = (msec > 0).then(|| tick.now + time);
        self.began = true;
        Ok(())
    }
}

impl Node for Timeout {
    fn tick(&mut self, tick: &mut Tick<'_>) -> Status {
        if !self.began
            && let Err(error) = self.begin(tick)
        {
            tick.fail("Timeout", Cause::from(error));
            return Status::Failure;
        }
        if let Some(deadline) = self.deadline
            && tick.now >= deadline
        {
            self.halt(tick);
            let at = deadline.as_secs();
            tick.fail("Timeout", Cause::new(format!("not done by {at} s of world time, when its limit ended")));
            return Status::Failure;
        }
        let status = self.child.tick(tick);
        match (status, self.deadline) {
            (Status::Running, Some(deadline)) => tick.wake_at(deadline),
            (Status::Running, None) => {}
            _ => self.began = false,
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.began = false;
    }
}

/// `LoopString`: the child once for each element of the list in `queue`, which it finds in `value`. Fails when the
/// child fails; answers `if_empty` when there is nothing in the list. Named as in BehaviorTree.CPP so that editors know
/// it, it takes elements of any type. Unlike there, the list is read once, at the start, and is left as it is.
pub(crate) struct ForEach {
    child: Slot,
    ports: Ports,
    left: Option<VecDeque<Value>>,
}

impl ForEach {
    pub(crate) fn new(ports: Ports, child: Slot) -> ForEach {
        ForEach { child, ports, left: None }
    }

    /// Takes the next element onto the blackboard; `None` after the last.
    fn next(&mut self, tick: &mut Tick<'_>) -> Result<Option<()>, PortError> {
        let Some(value) = self.left.as_mut().and_then(VecDeque::pop_front) else { return Ok(None) };
        self.ports.write(tick.blackboard, "value", value).map(Some)
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<Option<Status>, PortError> {
        let queue: Vec<Value> = self.ports.read(tick.blackboard, "queue")?;
        if queue.is_empty() {
            let answer: String = self.ports.read(tick.blackboard, "if_empty")?;
            return Ok(Some(if answer == "SUCCESS" { Status::Success } else { Status::Failure }));
        }
        self.left = Some(queue.into());
        Ok(None)
    }

    fn step(&mut self, tick: &mut Tick<'_>) -> Result<Status, PortError> {
        if self.left.is_none()
            && let Some(answer) = self.begin(tick)?
        {
            return Ok(answer);
        }
        loop {
            if !self.child.is_running() {
                if !tick.take_turn() {
                    return Ok(Status::Running);
                }
                if self.next(tick)?.is_none() {
                    return Ok(Status::Success);
                }
            }
            match self.child.tick(tick) {
                Status::Success => {}
                status => return Ok(status),
            }
        }
    }
}

impl Node for ForEach {
    fn tick(&mut self, tick: &mut Tick<'_>) -> Status {
        let status = self.step(tick).unwrap_or_else(|error| {
            tick.fail("LoopString", Cause::from(error));
            Status::Failure
        });
        if status.is_final() {
            self.left = None;
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.left = None;
    }
}
