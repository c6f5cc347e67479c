//! A ledger with promises, for unit tests.

use consort_protocol::auction::{
    AuctionEntry, AuctionId, AuctionRecord, BidVerdict, ChargingStop, PlannedRole, RoleSpan,
};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Branch, Command, CommandOutcome, Ledger, Priority, PromiseMove, Submission};
use consort_protocol::mission::{Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use consort_protocol::units::{BatteryShare, Energy, Seconds};
use consort_skills::domain::hospital;
use std::collections::BTreeMap;

/// The arm begins when the cart has ended.
const MISSION: &str = r#"{"mission": "bring", "roles": {"arm": {"kind": "managed"}, "cart": {"kind": "managed"}},
    "root": {"task": "all", "method": "sequential", "tasks": [
        {"task": "go", "type": "wait", "roles": ["cart"], "parameters": {"seconds": "5"}},
        {"task": "take", "type": "wait", "roles": ["arm"], "parameters": {"seconds": "5"}}]}}"#;

/// A ledger, and the index of its latest entry.
#[derive(Default)]
pub(crate) struct Log(pub(crate) Ledger, u64);

impl Log {
    pub(crate) fn apply(&mut self, command: Command) {
        self.1 += 1;
        let outcome = self.0.apply(Epoch { term: 1, index: self.1 }, command);
        assert!(!matches!(outcome, CommandOutcome::Refused(_)), "{outcome:?}");
    }

    /// Submits a mission with a cart of its own, and promises its role for the arm, which needs a tenth of the battery.
    pub(crate) fn add_mission(&mut self, cart: &str) -> MissionId {
        self.add_mission_of(cart, 0)
    }

    /// Does the same for a mission of a priority.
    pub(crate) fn add_mission_of(&mut self, cart: &str, priority: i64) -> MissionId {
        self.add(cart, priority, None)
    }

    /// Does the same for an arm that charges before the role, up to this charge.
    pub(crate) fn add_mission_after_charging(&mut self, cart: &str, until: f64) -> MissionId {
        let share = |share| BatteryShare::new(share).unwrap();
        let span = RoleSpan { from: None, to: None, time: Seconds::ZERO, energy: Energy::ZERO };
        let (charger, time) = ("Dock".parse().unwrap(), Seconds::ZERO);
        let stop = ChargingStop { charger, time, until: share(until), remaining: share(0.5) };
        self.add(cart, 0, Some(PlannedRole { charging: Some(stop), ..PlannedRole::alone(span, Seconds::ZERO) }))
    }

    fn add(&mut self, cart: &str, priority: i64, planned: Option<PlannedRole>) -> MissionId {
        let mission = MissionTemplate::parse(MISSION, Format::Json).unwrap();
        let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        let request = cart.parse().unwrap();
        let priority = Priority::new(priority).unwrap();
        let submission = Submission { priority, ..Submission::of(request, mission, division) };
        self.apply(Command::Submit(Box::new(submission)));
        let mission = self.0.missions().last().unwrap().id.clone();
        let (arm, cart_role): (RoleId, RoleId) = ("arm".parse().unwrap(), "cart".parse().unwrap());
        let robots = ["lab-arm", cart].map(|name| RobotId::new(name).unwrap());
        let holders = [arm.clone(), cart_role].into_iter().zip(robots).collect();
        let empty = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        let entry = AuctionEntry {
            role: arm.clone(),
            robot: "lab-arm".parse().unwrap(),
            verdict: BidVerdict::Viable { time: Seconds::ZERO, energy: 0.1, remaining: 0.5 },
            parts: vec![],
        };
        let planned = planned.map(|planned| (arm.clone(), planned)).into_iter().collect();
        let promised = [(arm, Seconds::ZERO)].into();
        let auction = AuctionRecord { entries: vec![entry], promised, planned, ..empty };
        self.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction });
        mission
    }

    /// Passes the promised role of the arm to another robot.
    pub(crate) fn pass_arm(&mut self, mission: &MissionId, robot: &str) {
        let role: RoleId = "arm".parse().unwrap();
        let epoch = self.0.mission(mission).unwrap().role_robots()[&role].epoch;
        let empty = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        let auction = AuctionRecord { promised: [(role.clone(), Seconds::ZERO)].into(), ..empty };
        let (mission, robot, cause) = (mission.clone(), robot.parse().unwrap(), "late".to_owned());
        self.apply(Command::MovePromise(Box::new(PromiseMove { mission, role, epoch, robot, cause, auction })));
    }

    /// Ends the role of the cart.
    pub(crate) fn end_cart(&mut self, mission: &MissionId) {
        let role: RoleId = "cart".parse().unwrap();
        let epoch = self.0.mission(mission).unwrap().role_robots()[&role].epoch;
        let accept = Command::Accept {
            mission: mission.clone(),
            role: role.clone(),
            epoch,
            incarnation: 1,
            from_checkpoint: false,
        };
        self.apply(accept);
        let (branch, ended, outcomes) = (Branch::Main, (0..9).collect(), BTreeMap::new());
        self.apply(Command::Progress { mission: mission.clone(), role, epoch, branch, ended, outcomes });
    }
}
