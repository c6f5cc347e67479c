//! The verdict: what must hold at the end, as far as it is visible from outside.

use super::faults::FaultCounts;
use super::fleet::ProcessFleet;
use super::mission_log::listed;
use super::occurrences::is_occurrence;
use super::workload::{OWN_REQUEST, Observed, Workload};
use consort_protocol::view::MissionsView;
use consort_tests::history::History;
use consort_text::count;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

/// Limit for all requests to be acknowledged and for all missions to end after the last fault.
const END_LIMIT: Duration = Duration::from_secs(600);

/// Interval at which the missions are read meanwhile.
const LOOK_INTERVAL: Duration = Duration::from_secs(1);

/// Verdict of a soak.
#[derive(Debug, Serialize)]
pub(super) struct Verdict {
    /// Acknowledged missions.
    pub(super) acknowledged: usize,
    /// Acknowledged missions of the user.
    pub(super) own: usize,
    /// Missions by their state at the end.
    pub(super) states: BTreeMap<&'static str, usize>,
    /// Calls of clients with a definite reply.
    pub(super) replies: usize,
    /// Acknowledged orders of people.
    pub(super) orders: usize,
    /// Number of these orders of each kind.
    pub(super) order_kinds: BTreeMap<&'static str, usize>,
    /// States of robots and of the ledger that show that the orders are followed.
    pub(super) order_states: usize,
    /// Number of times for which a carrier was connected to the charger.
    pub(super) charges: usize,
    /// Submitted occurrences of the schedule.
    pub(super) occurrences: u64,
    /// Number of terms with a coordinator.
    pub(super) terms: usize,
    /// Nodes that ended after a panic in Zenoh, and were started again.
    pub(super) failures_of_zenoh: u32,
    /// Number of faults of each kind.
    pub(super) faults: FaultCounts,
    /// Everything that did not hold.
    pub(super) violations: Vec<String>,
}

/// Waits for the end of all missions, ends the clients, and checks everything.
pub(super) async fn reach(
    fleet: &mut ProcessFleet,
    mut workload: Workload,
    history: &History,
    (faults, ended): (FaultCounts, Option<String>),
) -> Verdict {
    let mut violations: Vec<String> = ended.into_iter().collect();
    let deadline = Instant::now() + END_LIMIT;
    if let Err(violation) = end_submissions(fleet, &mut workload).await {
        violations.push(violation);
    }
    let own = workload.acknowledged.borrow().keys().filter(|request| request.starts_with(OWN_REQUEST)).count();
    let acknowledged: BTreeSet<String> = workload.acknowledged.borrow().values().cloned().collect();
    let mut missions = MissionsView::default();
    loop {
        if let Some(list) = listed(&workload.client).await {
            missions = list;
            if missions.missions.iter().all(|mission| mission.brief.status.detail.is_final()) {
                break;
            }
        }
        violations.extend(fleet.restart_ended().err());
        if Instant::now() >= deadline {
            let open = missions.missions.iter().filter(|mission| !mission.brief.status.detail.is_final());
            let open: Vec<String> = open.map(|mission| mission.brief.mission.to_string()).collect();
            violations.push(format!("missions that have not ended in time: {}", open.join(", ")));
            break;
        }
        sleep(LOOK_INTERVAL).await;
    }
    workload.missions.add(&missions);
    let missions = workload.missions.missions();
    let Observed { elected: terms, followed, occurrences } = workload.end().await;
    let requested = missions.missions.iter().filter(|mission| !is_occurrence(mission));
    let known: BTreeSet<String> = requested.map(|mission| mission.brief.mission.to_string()).collect();
    violations.extend(acknowledged.difference(&known).map(|mission| format!("{mission} was acknowledged and is lost")));
    violations
        .extend(known.difference(&acknowledged).map(|mission| format!("{mission} is a second mission of a request")));
    let submitted = occurrences.as_ref().map_or(0, |occurrences| occurrences.submitted);
    violations.extend(occurrences.and_then(|occurrences| occurrences.check(&missions)).err());
    violations.extend(followed.violations);
    for (term, nodes) in terms.iter().filter(|(_, nodes)| nodes.len() > 1) {
        let names: Vec<&str> = nodes.iter().map(|node| node.as_str()).collect();
        violations.push(format!("term {term} had several coordinators: {}", names.join(", ")));
    }
    violations.extend(history.check_linearizable().err());
    violations.extend(fleet.panics());
    let mut states = BTreeMap::new();
    for mission in &missions.missions {
        *states.entry(mission.brief.status.detail.as_str()).or_default() += 1;
    }
    let terms = terms.len();
    Verdict {
        acknowledged: acknowledged.len(),
        own,
        states,
        replies: history.replies(),
        orders: followed.orders.values().sum(),
        order_kinds: followed.orders,
        order_states: followed.states,
        charges: followed.charges,
        occurrences: submitted,
        terms,
        failures_of_zenoh: fleet.failures_of_zenoh,
        faults,
        violations,
    }
}

/// Waits until all requests are acknowledged. Meanwhile nodes are started again after a panic in Zenoh.
///
/// # Errors
/// A description of what did not hold.
async fn end_submissions(fleet: &mut ProcessFleet, workload: &mut Workload) -> Result<(), String> {
    let acknowledged = timeout(END_LIMIT, workload.end_submissions());
    tokio::pin!(acknowledged);
    loop {
        tokio::select! {
            ended = &mut acknowledged => {
                let problem = format!("not all requests were acknowledged within {} s", END_LIMIT.as_secs());
                return ended.map_err(|_| problem);
            }
            () = sleep(LOOK_INTERVAL) => fleet.restart_ended()?,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let FaultCounts { kills, stops, cuts, losses, partitions } = self.faults;
        let missions = count(self.acknowledged, "mission", "missions");
        let states = self.states.iter().map(|(state, number)| format!("{number} {}", state.replace('_', " ")));
        let states: Vec<String> = states.collect();
        let kinds = self.order_kinds.iter().map(|(kind, number)| format!("{number} {kind}"));
        let kinds: Vec<String> = kinds.collect();
        let held = if self.violations.is_empty() { "held" } else { "violated" };
        write!(
            f,
            "{held}: {missions} acknowledged ({}), {} checked, {}, {} ({}) followed in {}, {}, {}, {}; {} ({kills} kills, \
             {stops} stops, {cuts} cuts, {losses} losses, {partitions} partitions)",
            states.join(", "),
            count(self.replies, "reply", "replies"),
            count(self.occurrences as usize, "occurrence", "occurrences"),
            count(self.orders, "order", "orders"),
            kinds.join(", "),
            count(self.order_states, "state", "states"),
            count(self.charges, "charge", "charges"),
            count(self.terms, "term", "terms"),
            count(self.failures_of_zenoh as usize, "failure of Zenoh", "failures of Zenoh"),
            count(self.faults.total() as usize, "fault", "faults"),
        )?;
        self.violations.iter().try_for_each(|violation| write!(f, "\n  {violation}"))
    }
}
