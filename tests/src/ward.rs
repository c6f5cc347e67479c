//! Default fleet of the tests.

use crate::slug;
use consort_fleet::autopilot::{self, VOTERS};
use consort_fleet::coordinator::RequestLimits;
use consort_fleet::node::FleetSettings;
use consort_protocol::auction::{BidLimits, OptimalAssignment, PromiseTerms};
use consort_protocol::ensemble::{EnsembleSpec, Ensembles};
use consort_protocol::ids::{AlarmId, EnsembleId, PlaceId};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{AlarmPlan, AlarmResponse, HistoryLimits, MapPart, Zone};
use consort_protocol::timing::Timing;
use consort_skills::domain::hospital;
use consort_world::map::shipped;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// Returns the ensemble `logistics`: robots with any of these skills.
pub(crate) fn logistics(skills: &[&str]) -> EnsembleSpec {
    let skills = skills.iter().map(|skill| slug(skill)).collect();
    EnsembleSpec::with_any_skill_of(slug::<EnsembleId>("logistics"), skills)
}

/// Returns the settings of the fleet `ward`. Robots of these ensembles receive calls for bids. The
/// cluster is created once `bootstrap_expect` nodes have met.
pub(crate) fn ward(ensembles: Vec<EnsembleSpec>, bootstrap_expect: usize) -> FleetSettings {
    let ensembles = Ensembles::compile(ensembles).expect("valid ensembles");
    FleetSettings {
        fleet: slug("ward"),
        domain: Arc::new(hospital().with_ensembles(ensembles.names().cloned())),
        missions: Arc::default(),
        alarms: Arc::new(alarms()),
        devices: Arc::default(),
        ensembles: Arc::new(ensembles),
        limits: BidLimits::default(),
        charging: None,
        promises: PromiseTerms::default(),
        request_limits: RequestLimits::default(),
        history_limits: HistoryLimits::default(),
        allocator: Arc::new(OptimalAssignment),
        candidates: None,
        lease_terms: LeaseTerms::default(),
        bid_window: Duration::from_millis(200),
        stall_timeout: Duration::from_secs(15 * 60),
        bootstrap_expect,
        timing: Timing::Lan,
        voters: VOTERS,
        autopilot_rule: autopilot::decide,
        dead_after: Timing::Lan.parameters().dead_after,
        snapshot_every: consort_raft::SNAPSHOT_EVERY,
        log_entries_kept: consort_raft::LOG_ENTRIES_KEPT,
        scoped_knowledge: false,
        map: Some(Arc::new(shipped("hospital").expect("it is shipped").to_view())),
    }
}

/// Returns the alarms of the fleet: at `freeze` all robots stop, and at `fire` they assemble on the sides of the
/// crossing, which is closed as a zone.
fn alarms() -> BTreeMap<AlarmId, AlarmPlan> {
    let places = ["Dock", "IC Corridor 1", "PC Corridor 4"].map(slug::<PlaceId>);
    let crossing = MapPart::Zone(Zone { name: slug("crossing"), places: [slug("Crossing")].into() });
    let fire = AlarmPlan { robots: AlarmResponse::Assemble, places: places.into(), closes: [crossing].into() };
    let freeze = AlarmPlan { robots: AlarmResponse::Stop, places: BTreeSet::new(), closes: BTreeSet::new() };
    [(slug("fire"), fire), (slug("freeze"), freeze)].into()
}
