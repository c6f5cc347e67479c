//! The auctions of a reign, and who is served first.
//!
//! Missions are auctioned side by side. When a robot could serve two of them, the one that is served first gets it, by
//! priority and then by number: an auction whose bids are in, and which would fill its roles, first lets all better-ranked
//! missions conclude that are being called. Those that wait out a back-off are called at once, since what it has found may
//! be what they wait for. It waits for two windows at most.

use super::actor::{CoordinatorMessage, CoordinatorSettings};
use super::auctioneer;
use super::duties::{Closed, Phase, Round, back_off, may_be_called, taken};
use super::reign::{Reign, lock, members, propose};
use super::whereabouts::places;
use crate::replica::ProposeError;
use consort_protocol::auction::{
    Answer, AuctionEntry, AuctionId, AuctionRecord, CallForBids, Circumstances, Conclusion, Tender, Verdict,
    conclude_by,
};
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{Command, Outcome};
use consort_protocol::units::NodeTime;
use ractor::ActorRef;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::debug;

/// How long the ledger may take to accept an award.
const AWARD_LIMIT: Duration = Duration::from_secs(2);

/// After so many rounds in a row in which all who are left refuse a role for good, and at which somebody has failed before,
/// its mission is given up.
const HOPELESS_ROUNDS: u32 = 3;

/// Most robots that the cause of a failed mission names.
const NAMED: usize = 8;

impl Reign {
    pub(super) fn call(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: &MissionId,
        now: NodeTime,
    ) {
        let called = settings.replica.read(|ledger| {
            let entry = ledger.mission(mission)?;
            let plans = entry.open_roles().into_iter().map(|role| Some((role.clone(), entry.plan(&role)?.clone())));
            Some((entry.branch, plans.collect::<Option<BTreeMap<_, _>>>()?))
        });
        let Some((branch, roles)) = called.filter(|(_, roles)| !roles.is_empty()) else { return };
        let former = self.rounds.get_mut(mission).map(|round| {
            round.heed(branch, now);
            (round.number + 1, round.hopeless)
        });
        let (number, hopeless) = former.unwrap_or((1, 0));
        let auction = AuctionId { mission: mission.clone(), term: self.term, round: number };
        let call = CallForBids { auction, ensemble: settings.ensemble.spec().name.clone(), roles };
        let expected: BTreeSet<RobotId> = members(settings, now).into_iter().map(RobotId::from).collect();
        settings.events.tell(Happening::Called {
            mission: mission.clone(),
            roles: call.roles.keys().cloned().collect(),
            round: number,
            asked: expected.len(),
        });
        self.rounds.insert(mission.clone(), Round { number, branch, called: now, hopeless, phase: Phase::Calling });
        let (bus, keys, window, to) = (settings.bus.clone(), settings.keys.clone(), settings.window, myself.clone());
        self.tasks.spawn(async move {
            let tenders = auctioneer::collect(bus, keys, call.clone(), expected.clone(), window).await;
            // A coordinator that has stopped needs no bids.
            let _ = to.cast(CoordinatorMessage::Closed { call: Box::new(call), expected, tenders });
        });
    }

    /// All bids are in, or the window has closed.
    pub(super) fn close(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        call: CallForBids,
        expected: BTreeSet<RobotId>,
        tenders: Vec<Tender>,
    ) {
        let mission = call.auction.mission.clone();
        let current = |round: &&mut Round| round.number == call.auction.round && round.phase == Phase::Calling;
        let Some(round) = self.rounds.get_mut(&mission).filter(current) else {
            return; // the mission has ended, or another round has begun
        };
        for bid in tenders.iter().flat_map(|tender| &tender.answers) {
            if let Answer::Bid(bid) = bid {
                settings.events.tell(Happening::Bid { mission: mission.clone(), bid: bid.clone() });
            }
        }
        let until = settings.clock.now() + settings.window * 2;
        round.phase = Phase::Closed(Box::new(Closed { call, expected, tenders, until }));
        self.settle(settings, myself);
    }

    /// Concludes the closed auctions that need not wait for a better-ranked mission.
    pub(super) fn settle(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        if !self.rounds.values().any(|round| matches!(round.phase, Phase::Closed(_))) {
            return;
        }
        let now = settings.clock.now();
        let open = settings.replica.read(|ledger| {
            let watch = lock(&self.watch);
            let open = ledger.live().into_iter().filter(|entry| may_be_called(entry, &watch, now));
            open.map(|entry| entry.id.clone()).collect::<Vec<_>>()
        });
        let mut calling = false;
        let mut waiting: Vec<(MissionId, NodeTime)> = vec![];
        for mission in open {
            let Some(round) = self.rounds.get(&mission) else { continue };
            let called = round.called;
            match &round.phase {
                Phase::Calling => calling = true,
                Phase::Waiting { since, .. } => waiting.push((mission, *since)),
                Phase::Proposing(_) => {}
                Phase::Closed(closed) => {
                    let conclusion = self.conclude(settings, closed);
                    if conclusion.holders.is_some() && now < closed.until {
                        for (better, _) in waiting.iter().filter(|(_, since)| *since < called) {
                            self.call(settings, myself, better, now);
                            calling = true;
                        }
                        if calling {
                            continue; // and whoever comes after this one waits, too
                        }
                    }
                    self.decide(settings, myself, &mission, conclusion);
                }
            }
        }
    }

    fn conclude(&self, settings: &CoordinatorSettings, closed: &Closed) -> Conclusion {
        let Closed { call, expected, tenders, .. } = closed;
        let (taken, excluded) = settings.replica.read(|ledger| {
            let entry = ledger.mission(&call.auction.mission);
            let excluded = |role: &RoleId| entry.map(|entry| entry.excluded(role)).unwrap_or_default();
            let excluded = call.roles.keys().map(|role| (role.clone(), excluded(role))).collect();
            (taken(ledger, &self.rounds, &call.auction.mission), excluded)
        });
        let circumstances = Circumstances {
            expected,
            taken: &taken,
            excluded: &excluded,
            limits: &settings.limits,
            window_ms: u64::try_from(settings.window.as_millis()).unwrap_or(u64::MAX),
            at_ms: settings.clock.wall_ms(),
        };
        conclude_by(call, tenders, &circumstances, &*settings.choice)
    }

    fn decide(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: &MissionId,
        conclusion: Conclusion,
    ) {
        let Conclusion { holders, record, hopeless } = conclusion;
        let auction = record.auction.clone();
        settings.events.tell(Happening::Closed { mission: mission.clone(), record: record.clone() });
        let Some(round) = self.rounds.get_mut(mission) else { return };
        round.hopeless = if hopeless.is_empty() { 0 } else { round.hopeless + 1 };
        let (branch, given_up) = (round.branch, round.hopeless >= HOPELESS_ROUNDS);
        let command = match holders {
            Some(holders) => {
                round.phase = Phase::Proposing(holders.clone());
                Some(Command::Award { mission: mission.clone(), branch, holders, auction: record })
            }
            None => {
                let since = settings.clock.now();
                round.phase = Phase::Waiting { until: since + back_off(auction.round), since };
                let news = settings.replica.read(|ledger| {
                    let known = ledger.mission(mission).and_then(|entry| entry.auction.as_ref());
                    known.is_none_or(|known| tells_otherwise(known, &record))
                });
                if given_up {
                    let places = settings.replica.read(|ledger| places(&settings.knowledge, ledger.mission(mission)));
                    let cause = nobody_is_left(&hopeless, &record.entries);
                    let mission = mission.clone();
                    let fail = Command::Fail { mission, cause, branch: Some(branch), places };
                    propose(settings, &mut self.tasks, fail);
                }
                news.then(|| Command::Defer { mission: mission.clone(), branch, auction: record })
            }
        };
        let Some(command) = command else { return };
        let (replica, to) = (settings.replica.clone(), myself.clone());
        self.tasks.spawn(async move {
            let outcome = replica.propose(command, AWARD_LIMIT).await;
            // A coordinator that has stopped leaves the award to the next one: it is in the ledger or it is not.
            let _ = to.cast(CoordinatorMessage::Decided { auction, outcome });
        });
    }

    pub(super) fn decided(
        &mut self,
        settings: &CoordinatorSettings,
        auction: &AuctionId,
        outcome: Result<Outcome, ProposeError>,
    ) {
        let since = settings.clock.now();
        let mission = &auction.mission;
        let known_for = self.known_for(mission, since);
        let Some(round) = self.rounds.get_mut(mission).filter(|round| round.number == auction.round) else { return };
        let Phase::Proposing(holders) = &round.phase else { return };
        match outcome {
            Ok(Outcome::Awarded { epoch }) => {
                let after_ms = known_for.map(|known| known.as_secs_f64() * 1000.0);
                let (mission, holders) = (mission.clone(), holders.clone());
                settings.events.tell(Happening::Awarded { mission, holders, epoch, after_ms });
                // Should a role of it be released, the rounds begin anew.
                self.rounds.remove(&auction.mission);
            }
            Ok(outcome) => {
                debug!(%mission, ?outcome, "the award no longer fits the ledger");
                round.phase = Phase::Waiting { until: since + back_off(1), since };
            }
            Err(problem) => {
                // Whether it will be committed is unknown; the next look at the ledger tells.
                debug!(%mission, %problem, "the award was not committed");
                round.phase = Phase::Waiting { until: since + back_off(round.number), since };
            }
        }
    }
}

/// Whether a record says anything that the former one did not, times and counters aside.
fn tells_otherwise(known: &AuctionRecord, record: &AuctionRecord) -> bool {
    let gist = |record: &AuctionRecord| {
        let verdicts = record
            .entries
            .iter()
            .map(|entry| (entry.role.clone(), entry.robot.clone(), std::mem::discriminant(&entry.verdict)));
        (record.failure.clone(), verdicts.collect::<Vec<_>>())
    };
    gist(known) != gist(record)
}

/// `nobody is left for r1: amber failed at it before: …; birch lacks …`.
fn nobody_is_left(hopeless: &BTreeSet<RoleId>, entries: &[AuctionEntry]) -> String {
    let of_role = |role: &RoleId| {
        let refusals = entries.iter().filter(|entry| entry.role == *role).filter_map(|entry| match &entry.verdict {
            Verdict::Refused { reason } => Some(format!("{} {reason}", entry.robot)),
            Verdict::Viable { .. } | Verdict::Unviable { .. } => None,
        });
        let mut refusals: Vec<String> = refusals.collect();
        // Whoever failed is the reason; the others merely cannot help.
        refusals.sort_by_key(|refusal| !refusal.contains(" failed at it before: "));
        let more = refusals.len().saturating_sub(NAMED);
        refusals.truncate(NAMED);
        let more = if more > 0 { format!("; and {more} more") } else { String::new() };
        format!("nobody is left for {role}: {}{more}", refusals.join("; "))
    };
    hopeless.iter().map(of_role).collect::<Vec<_>>().join("; ")
}
