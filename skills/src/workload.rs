//! Missions of a user for fault injection and evaluations, with the domains that they need.

use crate::extensions::Extensions;
use crate::missions::{NamedMissions, shipped};
use consort_protocol::api::{MissionSource, SubmitRequest};
use consort_protocol::mission::{Domain, IhtnFields, Mission, MissionDocument, MissionErrors, TemplateKind};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A mission file of a user.
#[derive(Debug, Clone)]
pub struct UserMission {
    /// The mission.
    pub document: MissionDocument,
    /// The request for the mission, without parameters.
    pub request: SubmitRequest,
}

/// Missions of a user, and extensions of the standard domain.
#[derive(Debug, Clone, Default)]
pub struct Workload {
    /// The extensions.
    pub extensions: Extensions,
    missions: Arc<BTreeMap<String, UserMission>>,
}

impl Workload {
    /// Returns a workload of these missions.
    pub fn new(extensions: Extensions, missions: impl IntoIterator<Item = UserMission>) -> Workload {
        let missions = missions.into_iter().map(|mission| (mission.document.name().to_string(), mission)).collect();
        Workload { extensions, missions: Arc::new(missions) }
    }

    /// Adds missions, except those with the name of a mission of the user.
    #[must_use]
    pub fn with(mut self, missions: impl IntoIterator<Item = UserMission>) -> Workload {
        let own = Arc::make_mut(&mut self.missions);
        for mission in missions {
            own.entry(mission.document.name().to_string()).or_insert(mission);
        }
        self
    }

    /// Returns the names of the missions of the user.
    pub fn own_missions(&self) -> impl Iterator<Item = &str> + Clone {
        self.missions.keys().map(String::as_str)
    }

    /// Returns a mission of the user, or else a shipped mission.
    pub fn mission(&self, name: &str) -> Option<MissionDocument> {
        let own = self.missions.get(name).map(|mission| mission.document.clone());
        own.or_else(|| NamedMissions::default().document(name, &IhtnFields::default()).ok())
    }

    /// Returns the names of all missions.
    pub fn mission_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.own_missions().chain(shipped().keys().map(String::as_str))
    }

    /// Returns the request for a mission of the user, or else for a shipped mission, with these parameters.
    pub fn request(&self, name: &str, parameters: BTreeMap<String, String>) -> SubmitRequest {
        let own = self.missions.get(name).map(|mission| mission.request.clone());
        let request = own.unwrap_or_else(|| SubmitRequest::of(MissionSource::Named(name.to_owned())));
        SubmitRequest { parameters, ..request }
    }

    /// Returns the parameters with which the mission takes place in a room: the room for the parameter `room`, and for
    /// each other place or list of places without a default.
    pub fn parameters_in(&self, name: &str, room: &str) -> BTreeMap<String, String> {
        let is_place = |kind| matches!(kind, TemplateKind::Place | TemplateKind::Places);
        let document = self.mission(name);
        let parameters = document.iter().flat_map(MissionDocument::parameters);
        let in_room = parameters
            .filter(|(name, parameter)| is_place(parameter.kind) && (parameter.default.is_none() || *name == "room"));
        in_room.map(|(name, _)| (name.clone(), room.to_owned())).collect()
    }

    /// Returns the missions of the user in a room, each with its name.
    ///
    /// # Errors
    /// The name of a mission, and the problems of the mission.
    pub fn missions_in(&self, room: &str, domain: &Domain) -> Result<Vec<Mission>, (String, MissionErrors)> {
        let instantiate = |(name, mission): (&String, &UserMission)| {
            let created = mission.document.instantiate(&self.parameters_in(name, room), domain);
            created.map_err(|errors| (name.clone(), errors))
        };
        self.missions.iter().map(instantiate).collect()
    }
}
