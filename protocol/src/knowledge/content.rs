//! Content of a record: the abilities and the state of a node and of its robot.

use super::attributes::Attributes;
use super::devices::DeviceKnowledge;
use crate::bounds::{self, ELEMENTS_MAX};
use crate::domain_reference::DomainReference;
use crate::ids::{ClusterId, MissionId, PlaceId, RoleId, TaskType};
use crate::pose::Pose;
use crate::units::{BatteryShare, MetresPerSecond, Seconds, SharePerSecond};
use crate::versions::VersionRange;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Content of a node's record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Knowledge {
    /// True if the node may vote for the coordinator and be a voter of the ledger.
    pub may_vote: bool,
    /// True if the node does not move.
    pub stationary: bool,
    /// True if the node runs on mains power.
    pub mains_powered: bool,
    /// Member number in the ledger's consensus, if the node has a replica.
    pub replica: Option<u64>,
    /// Cluster of the node: that of its ledger, otherwise that of the first coordinator that it
    /// received a beacon from.
    pub cluster: Option<ClusterId>,
    /// True if the node is about to leave the fleet permanently.
    pub leaving: bool,
    /// Wire versions that its program reads.
    pub supported_versions: VersionRange,
    /// Robot of the node, if it is a robot's node.
    pub robot: Option<RobotKnowledge>,
    /// Devices of the building.
    pub devices: DeviceKnowledge,
    /// Domain files of its task types, for the health of the fleet only: a robot compares the file of each task itself.
    #[serde(deserialize_with = "bounds::collection::<_, _, DOMAINS_MAX>")]
    pub domains: BTreeSet<DomainReference>,
}

/// Maximum number of domain files that a node publishes. Raised: its record is larger, and differences of more files are
/// found. A guess.
pub const DOMAINS_MAX: usize = 16;

impl Availability {
    /// Returns the availability of a robot with this problem. A long description is shortened.
    pub fn out_of_service(mut problem: String) -> Availability {
        bounds::limit_text(&mut problem, bounds::TEXT_BYTES_MAX);
        Availability::OutOfService { problem }
    }
}

impl Knowledge {
    /// Returns the knowledge of a node that may vote, moves and runs on its battery, and belongs to no cluster yet.
    pub fn of(robot: Option<RobotKnowledge>) -> Knowledge {
        Knowledge {
            may_vote: true,
            stationary: false,
            mains_powered: false,
            replica: None,
            cluster: None,
            leaving: false,
            supported_versions: VersionRange::OWN,
            robot,
            devices: Default::default(),
            domains: BTreeSet::new(),
        }
    }

    /// Checks whether the node is a robot that can take a role now.
    pub fn is_free(&self) -> bool {
        self.robot.as_ref().is_some_and(|worker| worker.availability == Availability::Free)
    }
}

/// State and abilities of a robot, as published in its record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RobotKnowledge {
    /// Skills of the robot.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub skills: BTreeSet<TaskType>,
    /// Attributes of the robot, as in its file.
    #[serde(default)]
    pub attributes: Attributes,
    /// Current or last place on the map.
    pub place: PlaceId,
    /// Pose on the map.
    pub pose: Pose,
    /// Charge left.
    pub battery: BatteryShare,
    /// Discharge rate during work.
    pub discharge: SharePerSecond,
    /// Charge below which the robot is no longer useful.
    pub useful_charge: BatteryShare,
    /// Average speed; `None` if the robot does not drive.
    pub speed: Option<MetresPerSecond>,
    /// Availability for a role.
    pub availability: Availability,
    /// Version of its estimator: bids of different versions are not comparable.
    #[serde(deserialize_with = "bounds::signed_text")]
    pub estimator: String,
    /// Charging of a free robot; `None` if it neither charges nor needs to.
    #[serde(default)]
    pub charging: Option<Charging>,
}

impl RobotKnowledge {
    /// Checks whether the robot is free and connected to a charger.
    pub fn is_charging(&self) -> bool {
        self.availability == Availability::Free && matches!(self.charging, Some(Charging::Connected(_)))
    }
}

/// Charging of a free robot. The other robots leave a claimed charger to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Charging {
    /// The robot needs charge, and every charger that it may use is taken.
    Waiting {
        /// The nearest of these chargers: other robots leave them when they can.
        #[serde(deserialize_with = "bounds::collection::<_, _, AWAITED_MAX>")]
        chargers: BTreeSet<PlaceId>,
    },
    /// The robot is about to use a charger: it drives there, or connects to it.
    Bound(ChargerClaim),
    /// The robot is connected to a charger.
    Connected(ChargerClaim),
    /// The robot leaves a charger for another robot, or parks.
    Leaving {
        /// Place to which it drives: other robots that leave or park drive elsewhere.
        to: PlaceId,
    },
}

/// Maximum number of chargers that a waiting robot publishes. Raised: its record is larger, and more robots make room. A
/// guess.
pub const AWAITED_MAX: usize = 16;

impl Charging {
    /// Returns the claim, unless the robot waits or leaves.
    pub fn claim(&self) -> Option<&ChargerClaim> {
        match self {
            Charging::Waiting { .. } | Charging::Leaving { .. } => None,
            Charging::Bound(claim) | Charging::Connected(claim) => Some(claim),
        }
    }
}

/// Claim of a robot to a charger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ChargerClaim {
    /// Place of the charger.
    pub charger: PlaceId,
    /// Charge of the robot at the time of the claim. Of two claims without a lease, that with less charge prevails.
    pub battery: BatteryShare,
    /// Position in the log at which the coordinator has leased the charger to the robot; null without a lease. A claim
    /// with a lease prevails over a claim without, and over one with an earlier lease.
    #[serde(default)]
    pub lease: Option<u64>,
    /// Estimated time of the drive to the charger in seconds, at the time of the claim. The coordinator ends the lease of
    /// a robot that takes several times as long.
    #[serde(default)]
    pub drive_s: Option<Seconds>,
}

/// Availability of a robot for a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Availability {
    /// The robot can take a role.
    Free,
    /// The robot holds a role.
    Holding {
        /// Mission of the role.
        mission: MissionId,
        /// Role that it holds.
        role: RoleId,
        /// True if the robot is suspended since its lease was not renewed.
        suspended: bool,
    },
    /// The robot cannot execute a role.
    OutOfService {
        /// Description of the problem.
        #[serde(deserialize_with = "bounds::signed_text")]
        problem: String,
    },
}
