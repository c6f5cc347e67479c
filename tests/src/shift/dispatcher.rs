//! Allocation of carriers in advance: each mission is in the queue of a carrier before its auction.
//!
//! The auctions remain: they award the carrier that the queue states when it is free and has the charge, together with
//! an arm. A mission waits while its carrier is not free, or while another mission is before it in the queue.

use super::work::{CARRIER, WorkModel};
use crate::slug;
use consort_evaluation::shift::{ShiftJob, plan_in_hindsight, tessi_insertion};
use consort_protocol::auction::{Allocator, AllocatorInput, AssignmentError, Bid, OptimalAssignment};
use consort_protocol::ids::{MissionId, PlaceId, RobotId, RoleId};
use consort_protocol::timeline::{Job, Timeline};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard};
use tokio::time::Instant;

/// Missions that a carrier has not been awarded yet.
#[derive(Debug)]
struct CarrierQueue {
    /// Place where it is free for the first of them.
    place: PlaceId,
    /// Estimated time at which it is free, in seconds of world time since the creation of the queues.
    free_s: f64,
    /// Numbers of the requests in their order.
    jobs: Vec<usize>,
}

/// Latest assignment of a mission to its carrier. An award follows, unless the mission waits for another robot.
#[derive(Debug)]
struct Assignment {
    carrier: RobotId,
    /// Estimated time at which the carrier is free again.
    free_s: f64,
}

#[derive(Debug)]
struct State {
    queues: BTreeMap<RobotId, CarrierQueue>,
    numbers: BTreeMap<MissionId, usize>,
    assigned: BTreeMap<usize, Assignment>,
}

/// Allocator that follows queues. See the [module](self).
#[derive(Debug)]
pub(super) struct Dispatcher {
    jobs: Vec<ShiftJob<PlaceId>>,
    model: WorkModel,
    /// Requests are inserted in the queues when they are made.
    inserts: bool,
    created: Instant,
    /// World seconds per second of node time.
    world_speed: f64,
    state: Mutex<State>,
}

impl Dispatcher {
    /// Returns empty queues, in which requests are inserted by the rule of TeSSI when they are made.
    pub(super) fn tessi(
        jobs: Vec<ShiftJob<PlaceId>>,
        carriers: Vec<(RobotId, PlaceId)>,
        model: WorkModel,
        world_speed: f64,
    ) -> Dispatcher {
        let queue = |(robot, place)| (robot, CarrierQueue { place, free_s: 0.0, jobs: vec![] });
        let queues = carriers.into_iter().map(queue).collect();
        let state = State { queues, numbers: BTreeMap::new(), assigned: BTreeMap::new() };
        Dispatcher { jobs, model, inserts: true, created: Instant::now(), world_speed, state: Mutex::new(state) }
    }

    /// Returns the queues of a plan for all requests.
    pub(super) fn oracle(
        jobs: Vec<ShiftJob<PlaceId>>,
        carriers: Vec<(RobotId, PlaceId)>,
        model: WorkModel,
        world_speed: f64,
        seed: u64,
    ) -> Dispatcher {
        let (names, starts): (Vec<RobotId>, Vec<PlaceId>) = carriers.iter().cloned().unzip();
        let routes = plan_in_hindsight(&jobs, &starts, &model, seed);
        let dispatcher = Dispatcher { inserts: false, ..Dispatcher::tessi(jobs, carriers, model, world_speed) };
        let mut state = dispatcher.state();
        for (carrier, route) in names.iter().zip(routes) {
            state.queues.get_mut(carrier).expect("a queue for each").jobs = route;
        }
        drop(state);
        dispatcher
    }

    /// Notes the mission of a request that was made just now.
    pub(super) fn add(&self, number: usize, mission: MissionId) {
        let now_s = self.now_s();
        let mut state = self.state();
        state.numbers.insert(mission, number);
        if !self.inserts {
            return;
        }
        let job = |number: usize| {
            let ShiftJob { from, to, duration_s, .. } = &self.jobs[number];
            Job { to: to.clone(), duration_s: *duration_s, ..Job::at(number, from.clone()) }
        };
        let timeline = |queue: &CarrierQueue| {
            let jobs = queue.jobs.iter().map(|number| job(*number));
            Timeline::new(queue.place.clone(), queue.free_s.max(now_s)).with_jobs(jobs, &self.model)
        };
        let timelines: Vec<Timeline<usize, PlaceId>> = state.queues.values().map(timeline).collect();
        let (carrier, position) =
            tessi_insertion(&timelines, &job(number), &self.model).expect("every room can be reached");
        state.queues.values_mut().nth(carrier).expect("a timeline for each").jobs.insert(position, number);
    }

    /// Notes the award of a carrier.
    pub(super) fn note_award(&self, mission: &MissionId) {
        let mut state = self.state();
        let State { queues, numbers, assigned } = &mut *state;
        let number = numbers.get(mission).copied();
        let Some((number, assignment)) = number.and_then(|number| Some((number, assigned.get(&number)?))) else {
            return;
        };
        if let Some(queue) = queues.get_mut(&assignment.carrier) {
            queue.jobs.retain(|other| *other != number);
            (queue.place, queue.free_s) = (self.jobs[number].to.clone(), assignment.free_s);
        }
    }

    /// Notes the end of a mission, with or without a carrier.
    pub(super) fn note_end(&self, mission: &MissionId) {
        let mut state = self.state();
        if let Some(number) = state.numbers.get(mission).copied() {
            state.queues.values_mut().for_each(|queue| queue.jobs.retain(|other| *other != number));
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no panic while it is locked")
    }

    fn now_s(&self) -> f64 {
        self.created.elapsed().as_secs_f64() * self.world_speed
    }
}

impl State {
    /// Returns the carrier of a mission, if it is its turn. A mission that has lost its carrier gets it again.
    fn carrier_of(&self, number: usize) -> Option<RobotId> {
        let carrier = match self.queues.iter().find(|(_, queue)| queue.jobs.contains(&number)) {
            Some((carrier, queue)) => (queue.jobs.first() == Some(&number)).then_some(carrier),
            None => self.assigned.get(&number).map(|assignment| &assignment.carrier),
        };
        carrier.cloned()
    }
}

impl Allocator for Dispatcher {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let role: RoleId = slug(CARRIER);
        if !input.call.roles.contains_key(&role) {
            return OptimalAssignment.allocate(input); // the carrier is known
        }
        let mut state = self.state();
        let number = state.numbers.get(&input.call.auction.mission).copied();
        let turn = number.and_then(|number| Some((number, state.carrier_of(number)?)));
        let (number, carrier) = turn.ok_or(AssignmentError::NoRobotLeft)?;
        let fits = |bid: &&Bid| bid.role != role || bid.robot == carrier;
        let viable: Vec<&Bid> = input.viable.iter().copied().filter(fits).collect();
        let holders = OptimalAssignment.allocate(&AllocatorInput { viable: &viable, ..*input })?;
        let bid = viable.iter().find(|bid| bid.role == role && bid.robot == carrier);
        let work_s = bid.map_or(0.0, |bid| bid.time.get());
        state.assigned.insert(number, Assignment { carrier, free_s: self.now_s() + work_s });
        Ok(holders)
    }
}

#[cfg(test)]
mod tests {
    use super::super::work::ShiftRequest;
    use super::*;
    use consort_protocol::auction::{AuctionId, BidLimits, CallForBids, Timelines};
    use consort_protocol::plan::LocalPlan;
    use consort_protocol::units::{BatteryShare, Seconds};
    use std::collections::BTreeSet;

    /// Two rooms at different ends of the hospital.
    const ROOMS: [&str; 2] = ["IC Room 6", "PC Room 8"];

    /// Returns the parts of a dispatcher with a carrier in each room, and requests from these rooms.
    fn parts(requests: &[&str]) -> (Vec<ShiftJob<PlaceId>>, Vec<(RobotId, PlaceId)>, WorkModel) {
        let model = WorkModel::new(&ROOMS.map(slug::<PlaceId>));
        let request = |(number, room): (u32, &&str)| ShiftRequest { at_s: f64::from(number), room: slug(room) };
        let jobs = (0..).zip(requests).map(|numbered| model.job(&request(numbered))).collect();
        (jobs, vec![(slug("ada"), slug(ROOMS[0])), (slug("bob"), slug(ROOMS[1]))], model)
    }

    fn mission(number: usize) -> MissionId {
        slug(&format!("m-{number}"))
    }

    fn bid(robot: &str) -> Bid {
        Bid {
            robot: slug(robot),
            role: slug(CARRIER),
            time: Seconds::new(60.0).unwrap(),
            energy: 0.1,
            remaining: 0.5,
            useful_charge: BatteryShare::new(0.08).unwrap(),
            from: slug("Dock"),
            age_ms: 0,
            parts: vec![],
            present: None,
            planned: None,
        }
    }

    /// Returns the carrier of a mission in an auction in which these robots bid.
    fn allocate(dispatcher: &Dispatcher, number: usize, robots: &[&str]) -> Option<String> {
        let role: RoleId = slug(CARRIER);
        let call = CallForBids {
            auction: AuctionId { mission: mission(number), term: 1, round: 1 },
            ensembles: vec![],
            roles: [(role.clone(), LocalPlan::of(role.clone(), vec![]))].into(),
            eligible: BTreeMap::new(),
            spread: BTreeSet::new(),
            timelines: Timelines::default(),
        };
        let bids: Vec<Bid> = robots.iter().map(|robot| bid(robot)).collect();
        let bids: Vec<&Bid> = bids.iter().collect();
        let open: BTreeSet<RobotId> = robots.iter().map(|robot| slug(robot)).collect();
        let candidates = BTreeMap::from([(role.clone(), open)]);
        let limits = BidLimits::default();
        let input =
            AllocatorInput { call: &call, candidates: &candidates, bids: &bids, viable: &bids, limits: &limits };
        Some(dispatcher.allocate(&input).ok()?[&role].to_string())
    }

    #[test]
    fn missions_go_to_the_carriers_of_their_queues_in_order() {
        crate::paused_runtime().block_on(async {
            let (jobs, carriers, model) = parts(&[ROOMS[0], ROOMS[1], ROOMS[0]]);
            let dispatcher = Dispatcher::tessi(jobs, carriers, model, 1.0);
            let both = ["ada", "bob"];
            assert_eq!(allocate(&dispatcher, 0, &both), None, "it is in no queue");
            (0..3).for_each(|number| dispatcher.add(number, mission(number)));
            assert_eq!(allocate(&dispatcher, 0, &["bob"]), None, "it waits for ada");
            // Both carriers have a job, and that of bob ends first.
            assert_eq!(allocate(&dispatcher, 2, &both), None, "it is not its turn");
            assert_eq!(allocate(&dispatcher, 0, &both).as_deref(), Some("ada"));
            assert_eq!(allocate(&dispatcher, 1, &both).as_deref(), Some("bob"));
            assert_eq!(allocate(&dispatcher, 2, &both), None, "no robot was awarded");
            [0, 1].map(mission).iter().for_each(|mission| dispatcher.note_award(mission));
            assert_eq!(allocate(&dispatcher, 2, &both).as_deref(), Some("bob"));
            assert_eq!(allocate(&dispatcher, 0, &both).as_deref(), Some("ada"), "it lost its carrier");
        });
    }

    #[test]
    fn the_oracle_has_a_queue_for_requests_to_come() {
        crate::paused_runtime().block_on(async {
            let (jobs, carriers, model) = parts(&[ROOMS[1], ROOMS[0]]);
            let dispatcher = Dispatcher::oracle(jobs, carriers, model, 1.0, 1);
            dispatcher.add(0, mission(0));
            assert_eq!(allocate(&dispatcher, 1, &["ada", "bob"]), None, "it is not requested yet");
            dispatcher.add(1, mission(1));
            assert_eq!(allocate(&dispatcher, 1, &["ada", "bob"]).as_deref(), Some("ada"));
            dispatcher.note_end(&mission(1));
            assert_eq!(allocate(&dispatcher, 0, &["ada", "bob"]).as_deref(), Some("bob"));
        });
    }
}
