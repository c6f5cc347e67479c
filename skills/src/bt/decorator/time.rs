//! Decorators that depend on world time.

use crate::bt::node::{ChildNode, Node};
use crate::bt::ports::{PortError, Ports};
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};
use consort_protocol::units::{Seconds, WorldTime};

/// `Timeout`: halts the child and fails if the child is still running `msec` milliseconds of world
/// time after its start; 0 means no limit.
pub(crate) struct Timeout {
    child: ChildNode,
    ports: Ports,
    deadline: Option<WorldTime>,
    is_started: bool,
}

impl Timeout {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> Timeout {
        Timeout { child, ports, deadline: None, is_started: false }
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<(), PortError> {
        let time = milliseconds(&self.ports, tick, "msec")?;
        self.deadline = (time > Seconds::ZERO).then(|| tick.now + time);
        self.is_started = true;
        Ok(())
    }
}

impl Node for Timeout {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        if !self.is_started
            && let Err(error) = self.begin(tick)
        {
            tick.set_cause("Timeout", Cause::from(error));
            return NodeStatus::Failure;
        }
        if let Some(deadline) = self.deadline
            && tick.now >= deadline
        {
            self.halt(tick);
            let at = deadline.as_secs();
            tick.set_cause("Timeout", Cause::new(format!("not complete at {at} s of world time, its time limit")));
            return NodeStatus::Failure;
        }
        let status = self.child.tick(tick);
        self.is_started = status == NodeStatus::Running;
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.is_started = false;
    }
}

/// `Delay`: executes the child `delay_msec` milliseconds of world time after the start of the node.
pub(crate) struct Delay {
    child: ChildNode,
    ports: Ports,
    start_child_at: Option<WorldTime>,
}

impl Delay {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> Delay {
        Delay { child, ports, start_child_at: None }
    }

    fn start_child_at(&mut self, tick: &Tick<'_>) -> Result<WorldTime, PortError> {
        match self.start_child_at {
            Some(time) => Ok(time),
            None => Ok(*self.start_child_at.insert(tick.now + milliseconds(&self.ports, tick, "delay_msec")?)),
        }
    }
}

impl Node for Delay {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        match self.start_child_at(tick) {
            Ok(time) if tick.now < time => return NodeStatus::Running,
            Ok(_) => {}
            Err(error) => {
                tick.set_cause("Delay", Cause::from(error));
                return NodeStatus::Failure;
            }
        }
        let status = self.child.tick(tick);
        if status != NodeStatus::Running {
            self.start_child_at = None;
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.start_child_at = None;
    }
}

/// Reads a port in milliseconds; a negative value counts as zero.
fn milliseconds(ports: &Ports, tick: &Tick<'_>, port: &str) -> Result<Seconds, PortError> {
    let msec: i64 = ports.read(tick.blackboard, port)?;
    Ok(Seconds::new(msec as f64 / 1000.0).unwrap_or(Seconds::ZERO))
}
