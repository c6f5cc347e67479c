//! Earliest starts of roles that wait for others, by the estimates of the roles before them.
//!
//! The steps of all roles and their signals form a simple temporal network. A step ends after the steps that it follows, and after
//! its own duration; a wait ends when its signal is sent. What is unknown takes no time, so a start is a lower bound
//! of what the estimates permit.

use super::local::{LocalPlan, Signal, StepAction};
use crate::ids::RoleId;
use std::collections::BTreeMap;

/// Plan of a role with its estimate.
#[derive(Debug, Clone)]
pub struct EstimatedPlan<'a> {
    /// The plan.
    pub plan: &'a LocalPlan,
    /// Begin of its first step in seconds; 0 if it is unknown.
    pub begin_s: f64,
    /// Duration of each step in seconds; steps without one count as 0.
    pub durations_s: Vec<f64>,
}

/// Times at which signals are sent, in seconds.
type SendTimes<'a> = BTreeMap<&'a Signal, f64>;

impl EstimatedPlan<'_> {
    /// Returns the begin and the end of each step, if the robot begins the first one at a time.
    fn steps(&self, begin_s: f64, sent: &SendTimes<'_>) -> Vec<(f64, f64)> {
        let mut steps: Vec<(f64, f64)> = Vec::with_capacity(self.plan.steps.len());
        for (index, step) in self.plan.steps.iter().enumerate() {
            let before = step.after.iter().filter_map(|before| steps.get(*before as usize));
            let from_s = before.map(|(_, end_s)| *end_s).fold(begin_s, f64::max);
            let end_s = match &step.action {
                StepAction::Task { .. } => from_s + self.durations_s.get(index).copied().unwrap_or(0.0),
                StepAction::Send(_) => from_s,
                StepAction::Wait(signal) => sent.get(signal).map_or(from_s, |sent_s| from_s.max(*sent_s)),
            };
            steps.push((from_s, end_s));
        }
        steps
    }
}

/// Returns the time in seconds at which each role can perform its first step, by the other roles; 0 for a role that waits for
/// none. A signal for which `is_sent` is true is there.
pub fn earliest_starts(
    roles: &BTreeMap<RoleId, EstimatedPlan<'_>>,
    is_sent: impl Fn(&Signal) -> bool,
) -> BTreeMap<RoleId, f64> {
    let mut sent = SendTimes::new();
    // Each pass follows the chains of signals by a role; a chain that returns to a role takes further passes.
    let passes = roles.values().map(|role| role.plan.steps.len()).sum::<usize>() + 1;
    for _ in 0..passes {
        let mut next = SendTimes::new();
        for role in roles.values() {
            let times = role.steps(role.begin_s, &sent);
            for (step, (_, end_s)) in role.plan.steps.iter().zip(times) {
                if let StepAction::Send(signal) = &step.action
                    && !is_sent(signal)
                {
                    next.insert(signal, end_s);
                }
            }
        }
        if next == sent {
            break;
        }
        sent = next;
    }
    let start_of = |role: &EstimatedPlan<'_>| {
        let steps = role.plan.steps.iter().zip(role.steps(0.0, &sent));
        let actions = steps.filter(|(step, _)| !matches!(step.action, StepAction::Wait(_)));
        actions.map(|(_, (from_s, _))| from_s).reduce(f64::min).unwrap_or(0.0)
    };
    roles.iter().map(|(id, role)| (id.clone(), start_of(role))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mission::TaskSpec;
    use crate::plan::{SignalKind, Step};

    fn role(name: &str) -> RoleId {
        name.parse().unwrap()
    }

    fn signal(from: &str, to: &str) -> Signal {
        Signal { kind: SignalKind::Done, task: "it".parse().unwrap(), from: role(from), to: role(to) }
    }

    /// Returns a plan with these steps in sequence.
    fn chain(of: &str, actions: Vec<StepAction>) -> LocalPlan {
        let after = |index: u32| index.checked_sub(1).into_iter().collect();
        let steps = (0..).zip(actions).map(|(index, action)| Step { action, after: after(index) });
        LocalPlan::of(role(of), steps.collect())
    }

    fn task(of: &str) -> StepAction {
        let spec = TaskSpec::of("wait".parse().unwrap(), vec![role(of)]);
        StepAction::Task { id: "it".parse().unwrap(), spec }
    }

    fn starts(begin_s: f64, is_sent: bool) -> Vec<f64> {
        let cart = chain("cart", vec![task("cart"), StepAction::Send(signal("cart", "arm")), task("cart")]);
        let arm = chain(
            "arm",
            vec![StepAction::Wait(signal("cart", "arm")), task("arm"), StepAction::Send(signal("arm", "lift"))],
        );
        let lift = chain("lift", vec![StepAction::Wait(signal("arm", "lift")), task("lift")]);
        let plan = |plan, begin_s| EstimatedPlan { plan, begin_s, durations_s: vec![10.0, 5.0, 0.0] };
        let roles =
            [(role("cart"), plan(&cart, begin_s)), (role("arm"), plan(&arm, 0.0)), (role("lift"), plan(&lift, 0.0))];
        earliest_starts(&roles.into(), |signal| is_sent && signal.from == role("cart")).into_values().collect()
    }

    #[test]
    fn a_role_starts_when_the_roles_before_it_have_sent_their_signals() {
        assert_eq!(starts(100.0, false), [110.0, 0.0, 115.0], "arm, cart, lift");
        assert_eq!(starts(100.0, true), [0.0, 0.0, 5.0], "the cart has sent its signal");
    }
}
