//! Composition of a fleet for chaos runs.

use crate::fleet::nurses_in;
use crate::{RobotSpec, slug};
use consort_protocol::ids::{PlaceId, RoleId, TaskType};
use consort_protocol::mission::{Domain, Mission, MissionErrors};
use consort_skills::workload::Workload;
use consort_world::map;
use consort_world::world::PersonSetup;
use std::collections::BTreeSet;

/// Rooms with a nurse and a sample each, in the order of use.
pub(crate) const ROOMS: [&str; 12] = [
    "IC Room 6",
    "PC Room 1",
    "IC Room 2",
    "PC Room 5",
    "IC Room 4",
    "PC Room 2",
    "IC Room 1",
    "PC Room 6",
    "IC Room 5",
    "PC Room 3",
    "IC Room 3",
    "PC Room 7",
];

/// Rooms without a nurse. Missions that fetch a sample from such a room cannot be completed.
pub(crate) const ROOMS_WITHOUT_NURSE: [&str; 2] = ["PC Room 4", "PC Room 8"];

/// Role of a person that never answers.
pub(super) const ABSENT: &str = "visitor";

/// Missions of the clients: without and with a recovery branch for the loss of the sample.
pub(crate) const MISSIONS: [&str; 2] = ["lab-samples", "lab-samples-watched"];

const STATIONS: [&str; 6] = ["aster", "basil", "clove", "dill", "elder", "flax"];
const CARRIERS: [(&str, &str); 6] = [
    ("garnet", "Dock"),
    ("hazel", "IC Room 4"),
    ("indigo", "PC Room 8"),
    ("jasper", "IC Room 2"),
    ("kelp", "PC Room 2"),
    ("linden", "Dock"),
];

/// The robot that takes samples out of drawers; the only one, except in a shift.
pub(crate) const ARM: &str = "lab-arm";

/// Arms of a shift, in the order of use.
pub const SHIFT_ARMS: [&str; 3] = [ARM, "lab-arm-2", "lab-arm-3"];

/// Carriers of a shift, in the order of use.
pub const SHIFT_CARRIERS: [&str; 20] = [
    "garnet", "hazel", "indigo", "jasper", "kelp", "linden", "moss", "nettle", "oxalis", "poppy", "quince", "reed",
    "sage", "thyme", "umber", "violet", "willow", "yarrow", "zinnia", "agate",
];

/// The node that hosts the simulated robots and the people. It is not part of the node count.
pub(crate) const WORLD: &str = "world";

/// Smallest fleet that can carry out a mission and survive the loss of one voter.
pub const NODES_MIN: usize = 4;

/// Number of available node names.
pub const NODES_MAX: usize = 13;

/// Composition of a fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChaosFleet {
    /// Stationary nodes that vote.
    pub stations: Vec<&'static str>,
    /// Robots with a drawer.
    pub carriers: Vec<&'static str>,
    /// Robots that take samples out of drawers.
    pub arms: Vec<&'static str>,
}

impl ChaosFleet {
    /// Returns a fleet of `nodes` nodes, without the world host: an arm, and carriers and stations in equal parts.
    ///
    /// # Panics
    /// If `nodes` is outside [`NODES_MIN`] to [`NODES_MAX`]. The caller has checked it.
    pub fn of(nodes: usize) -> ChaosFleet {
        assert!((NODES_MIN..=NODES_MAX).contains(&nodes), "{nodes} nodes");
        let carriers = (nodes - 1) / 2;
        let stations = nodes - 1 - carriers;
        ChaosFleet {
            stations: STATIONS[..stations].to_vec(),
            carriers: CARRIERS[..carriers].iter().map(|(name, _)| *name).collect(),
            arms: vec![ARM],
        }
    }

    /// Returns the fleet of a shift, with three stations.
    ///
    /// # Panics
    /// If there are more carriers than [`SHIFT_CARRIERS`], or more arms than [`SHIFT_ARMS`]. The caller has checked it.
    pub(crate) fn of_shift(carriers: usize, arms: usize) -> ChaosFleet {
        ChaosFleet {
            stations: STATIONS[..3].to_vec(),
            carriers: SHIFT_CARRIERS[..carriers].to_vec(),
            arms: SHIFT_ARMS[..arms].to_vec(),
        }
    }

    /// Returns all nodes, the world host last.
    pub fn nodes(&self) -> Vec<&'static str> {
        let robots = self.carriers.iter().chain(&self.arms).chain([&WORLD]);
        self.stations.iter().chain(robots).copied().collect()
    }

    /// Returns the first voters: at most five, an odd number, stationary nodes first.
    pub(crate) fn voters(&self) -> Vec<&'static str> {
        let mut all: Vec<_> = self.stations.iter().chain(&self.arms).copied().collect();
        all.sort_unstable();
        all.extend(&self.carriers);
        let most = all.len().min(consort_fleet::autopilot::VOTERS);
        all.truncate(if most % 2 == 0 { most - 1 } else { most });
        all
    }

    /// Returns the setups of its carriers, and the people. The carriers have the skills that the missions of the
    /// workload need and the arm lacks, and there is a person on call for each role of people in these missions, except
    /// for the role that never answers.
    pub(crate) fn participants(&self, workload: &Workload) -> (Vec<RobotSpec>, Vec<PersonSetup>) {
        let place = |name: &str| CARRIERS.iter().find(|(known, _)| *known == name).map_or("Dock", |(_, place)| place);
        let missions = user_missions(workload).expect("the missions of a workload are checked");
        let UserParticipants { skills, mut people } = UserParticipants::of(&missions);
        people.retain(|person| person.role.as_str() != ABSENT);
        let carrier = |name: &&str| {
            let carrier = RobotSpec::carrier(name, place(name)).with_skill("wait").with_charge(1.0);
            let known: BTreeSet<String> = carrier.skills.iter().cloned().collect();
            let more = skills.iter().map(TaskType::as_str).filter(|skill| !known.contains(*skill));
            more.fold(carrier, RobotSpec::with_skill)
        };
        (self.carriers.iter().map(carrier).collect(), nurses_in(&ROOMS).into_iter().chain(people).collect())
    }
}

/// Skills and people that missions of a user need.
#[derive(Debug, Default)]
pub struct UserParticipants {
    /// Task types of the roles that an arm lacks the skills for.
    pub skills: BTreeSet<TaskType>,
    /// A person on call for each role of people.
    pub people: Vec<PersonSetup>,
}

impl UserParticipants {
    /// Returns the skills and people that these missions need.
    pub fn of(missions: &[Mission]) -> UserParticipants {
        let of_arm = RobotSpec::arm(ARM, "Laboratory").skills.iter().map(|skill| slug(skill)).collect();
        let of_roles =
            missions.iter().flat_map(|mission| mission.managed_roles().map(|role| mission.task_types_of(role)));
        let skills = of_roles.filter(|skills| !skills.is_subset(&of_arm)).flatten().collect();
        let roles: BTreeSet<RoleId> = missions.iter().flat_map(Mission::unmanaged_roles).cloned().collect();
        let on_call = |role: RoleId| PersonSetup {
            endless_samples: true,
            on_call: true,
            ..PersonSetup::new(&format!("{role} on call"), role, slug("Dock"))
        };
        UserParticipants { skills, people: roles.into_iter().map(on_call).collect() }
    }
}

/// Returns the missions of a workload in a room of the hospital.
///
/// # Errors
/// The name of a mission, and its problems: a place that the hospital lacks, a task type that no domain declares, or
/// a parameter without a default that is no place.
pub fn user_missions(workload: &Workload) -> Result<Vec<Mission>, (String, MissionErrors)> {
    if workload.own_missions().next().is_none() {
        return Ok(vec![]); // the map is not needed
    }
    let map = map::shipped("hospital").expect("the shipped map is sound");
    let places: Vec<PlaceId> = map.topology().places.into_keys().collect();
    let domain: Domain = workload.extensions.domain().with_places(places);
    workload.missions_in(ROOMS[0], &domain)
}
