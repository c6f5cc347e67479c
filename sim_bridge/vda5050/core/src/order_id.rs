//! Ids of orders.

use std::fmt;
use std::str::FromStr;

/// Id of an order. It contains the goal, so that an adapter that starts while the vehicle executes the
/// order recognises it.
///
/// Ids of goals grow: a restarted node continues above all earlier ids, so the goal is a fencing token
/// between two adapters for one vehicle.
///
/// A goal keeps its id when the coordinator or the adapter is replaced. It contains the incarnation of the
/// node and a number, and not the mission, role and epoch of the award: a restarted node asks for the same
/// action with another id. The node then states the first goal of its task, and an order for the same work
/// since that goal counts as the order of the new goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct OrderId {
    /// The goal of the node.
    pub goal: u64,
    /// Fingerprint of the action and its parameters ([`fingerprint`]).
    pub work: u32,
    /// Number of earlier orders for the goal. A vehicle that lost an order in a restart receives
    /// another.
    pub attempt: u32,
    /// Latest actions that were sent before the order, so that the vehicle stores them during later drives. Empty for an
    /// order with an action, whose id is then the same in every process, and for a drive before which they are unknown.
    pub acts: Acts,
}

/// Number of actions that an id names. More let a vehicle show longer tasks, and make the ids longer.
const ACTS_MAX: usize = 4;

/// Goal and work of the latest actions that may have been sent, the latest first. All actions since the oldest of them
/// are among them.
pub(crate) type Acts = [Option<(u64, u32)>; ACTS_MAX];

/// Returns the latest of some actions, which are in the order of [`Acts`].
pub(crate) fn latest_of(actions: impl IntoIterator<Item = (u64, u32)>) -> Acts {
    let mut acts = Acts::default();
    for (place, act) in acts.iter_mut().zip(actions) {
        *place = Some(act);
    }
    acts
}

/// First part of the text of an id.
const PREFIX: &str = "consort";

/// Part of the id of a cancel after the order.
const CANCEL: &str = "-x";

impl OrderId {
    /// Returns the id of an action of the order. It is a function of the order, so a repeated order
    /// repeats no action.
    pub fn action(&self, index: usize) -> String {
        format!("{self}-a{index}")
    }

    /// Returns the id of the instant action that cancels the order. A later process sees by it that the order was cancelled.
    pub(crate) fn cancel(&self, session: u64, number: u64) -> String {
        format!("{self}{CANCEL}{session}-{number}")
    }

    /// Checks whether an instant action cancels the order, by its id.
    pub(crate) fn is_cancel(&self, action: &str) -> bool {
        action.strip_prefix(&self.to_string()).is_some_and(|rest| rest.starts_with(CANCEL))
    }

    /// Returns the latest actions that may have been sent, with this order and before it.
    pub(crate) fn latest_acts(&self) -> Acts {
        self.acts_after(Acts::default())
    }

    /// Returns the latest actions after this order, from those before it. An order that names none counts as an action
    /// itself.
    pub(crate) fn acts_after(&self, before: Acts) -> Acts {
        if self.acts[0].is_some() {
            return self.acts;
        }
        let earlier = before.into_iter().flatten().filter(|(goal, _)| *goal != self.goal);
        latest_of([(self.goal, self.work)].into_iter().chain(earlier))
    }

    /// Returns the order of an action, from the id of the action.
    ///
    /// # Errors
    /// The text is no id of an action of Consort.
    pub(crate) fn of_action(action: &str) -> Result<OrderId, OrderIdError> {
        action.strip_suffix("-a0").ok_or(OrderIdError)?.parse()
    }
}

impl fmt::Display for OrderId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{PREFIX}-{}-{:08x}-{}", self.goal, self.work, self.attempt)?;
        // The distance to an earlier goal is shorter than its id.
        let mut acts = self.acts.iter().flatten();
        acts.try_for_each(|(goal, work)| write!(f, "-{}-{work:08x}", self.goal.wrapping_sub(*goal)))
    }
}

/// A text is no id of an order of Consort.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no id of an order of Consort")]
pub struct OrderIdError;

impl FromStr for OrderId {
    type Err = OrderIdError;

    fn from_str(text: &str) -> Result<OrderId, OrderIdError> {
        let parts: Vec<&str> = text.split('-').collect();
        let [PREFIX, goal, work, attempt, ref named @ ..] = parts[..] else { return Err(OrderIdError) };
        let goal_and_work = |goal: &str, work: &str| -> Result<(u64, u32), OrderIdError> {
            let goal = goal.parse().map_err(|_| OrderIdError)?;
            Ok((goal, u32::from_str_radix(work, 16).map_err(|_| OrderIdError)?))
        };
        let (goal, work) = goal_and_work(goal, work)?;
        let mut acts = Acts::default();
        for (place, act) in acts.iter_mut().zip(named.chunks(2)) {
            let [distance, work] = act else { return Err(OrderIdError) };
            let (distance, work) = goal_and_work(distance, work)?;
            *place = Some((goal.wrapping_sub(distance), work));
        }
        let id = OrderId { goal, work, attempt: attempt.parse().map_err(|_| OrderIdError)?, acts };
        // Another spelling of the same numbers, or more actions, are the id of another program.
        if id.to_string() == text { Ok(id) } else { Err(OrderIdError) }
    }
}

/// Returns the fingerprint (FNV-1a) of a text. It is the same in every version of the program.
pub fn fingerprint(text: &str) -> u32 {
    text.bytes().fold(0x811c_9dc5, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_read_back_from_its_text() {
        let id = OrderId { goal: 1 << 60, work: fingerprint("vacuum"), attempt: 2, acts: Acts::default() };
        assert_eq!(id.to_string().parse(), Ok(id));
        let acts = latest_of([(id.goal - 1, 2), (id.goal - 3, 1)]);
        let drive = OrderId { acts, ..id };
        assert_eq!(drive.to_string(), format!("{id}-1-00000002-3-00000001"));
        assert_eq!(drive.to_string().parse(), Ok(drive));
        assert_eq!((id.latest_acts(), drive.latest_acts()), (latest_of([(id.goal, id.work)]), acts));
        assert_eq!(id.acts_after(latest_of([(7, 1)])), latest_of([(id.goal, id.work), (7, 1)]));
        let full = OrderId { acts: latest_of((1..9).map(|distance| (id.goal - distance, 5))), ..id };
        assert_eq!(full.to_string(), format!("{id}-1-00000005-2-00000005-3-00000005-4-00000005"));
        assert_eq!(full.to_string().parse(), Ok(full));
        assert_eq!(format!("{full}-5-00000005").parse::<OrderId>(), Err(OrderIdError), "too many");
        assert_eq!(id.action(0), format!("{id}-a0"));
        assert_eq!(OrderId::of_action(&id.action(0)), Ok(id));
        assert_eq!(OrderId::of_action(&id.to_string()), Err(OrderIdError));
        let cancel = id.cancel(1, 2);
        assert_eq!(
            (id.is_cancel(&cancel), drive.is_cancel(&cancel), id.is_cancel(&id.action(0))),
            (true, false, false)
        );
        assert_eq!((id.is_cancel(&drive.cancel(1, 2)), OrderId::of_action(&cancel)), (false, Err(OrderIdError)));
        let parts = ["consort-7-1", "consort-7-0000000G-0", "consort-07-00000001-0", "consort-7-00000001-0-6"];
        for foreign in ["", "order-7", "consort-7-00000001-0-06-00000001"].into_iter().chain(parts) {
            assert_eq!(foreign.parse::<OrderId>(), Err(OrderIdError), "{foreign}");
        }
    }

    #[test]
    fn the_fingerprint_is_that_of_fnv() {
        assert_eq!((fingerprint(""), fingerprint("a")), (0x811c_9dc5, 0xe40c_292c));
    }
}
