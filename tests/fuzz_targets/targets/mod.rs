//! Targets: one function per kind of untrusted input. It reads the bytes as the program does and
//! panics if a required property is violated. Two programs call the targets: the test next to this
//! folder, with seeds and seeded mutations, and cargo-fuzz (`tests/fuzz/`).
//!
//! Required properties, besides speed, little memory and no panic: decoded values can be encoded
//! and decode to the same values; the output of an importer passes its own checks; a rejection has
//! a message.

mod behavior_files;
mod domains;
mod frames;
mod ledgers;
mod maps;
mod messages;
mod missions;
mod recordings;
mod robots;
mod scratch;
mod settings;
mod stores;
mod trust;

/// A kind of untrusted input.
pub(crate) struct Target {
    /// Name of the fuzz target and of its corpus folder.
    pub(crate) name: &'static str,
    /// Reads an input. Returns whether any part of it was valid.
    pub(crate) run: fn(&[u8]) -> bool,
}

macro_rules! targets {
    ($($(#[doc = $doc:literal])* $name:ident = $hit:path;)*) => {
        /// All targets.
        pub(crate) const ALL: &[Target] = &[$(Target { name: stringify!($name), run: $hit }),*];
    };
}

targets! {
    /// Messages between nodes, of each kind.
    wire = messages::wire;
    /// Signed envelopes, and the permissions of their signers.
    signed_envelope = trust::signed_envelope;
    /// Certificates of peers, and revocation lists.
    certificate = trust::certificate;
    /// Certificates in files.
    pem = trust::pem;
    /// Names, identities and key expressions.
    names = trust::names;
    /// Gossip: a sequence of failure detection packets, statements and exchanges.
    gossip = messages::gossip;
    /// Consensus: requests, replies, log entries, snapshots.
    raft = messages::raft;
    /// Awards, executed.
    award = robots::award;
    /// Checkpoints of robots.
    checkpoint = robots::checkpoint;
    /// Sequences of ledger commands.
    ledger = ledgers::ledger;
    /// Damaged stores.
    store = stores::store;
    /// Requests of clients.
    request = missions::request;
    /// Missions in YAML.
    mission_yaml = missions::yaml;
    /// Missions in JSON.
    mission_json = missions::json;
    /// Missions in the flat format.
    ihtn = missions::ihtn;
    /// Domain files.
    domain = domains::domain;
    /// Lines of drivers.
    driver = domains::driver;
    /// Maps of this project in YAML.
    map_yaml = maps::yaml;
    /// Maps of this project in JSON, and maps of the published evaluation.
    map_json = maps::json;
    /// Drawings of diagrams.net.
    drawing = maps::drawing;
    /// Buildings of Open-RMF.
    building = maps::building;
    /// Layouts of VDMA.
    layout = maps::layout;
    /// Behavior trees.
    tree = behavior_files::tree;
    /// Conditions of ensembles.
    condition = behavior_files::condition;
    /// Features in Gherkin.
    feature = behavior_files::feature;
    /// Fleet, robot, station and world files.
    config = settings::config;
    /// Designs of evaluations.
    design = settings::design;
    /// Calibrations.
    calibration = settings::calibration;
    /// Workers, scenarios, results, measured legs and chaos schedules.
    tables = settings::tables;
    /// Recordings.
    recording = recordings::recording;
    /// Inputs of the fleet model.
    fleet_model = recordings::fleet_model;
    /// Requests to the dashboard.
    dashboard = recordings::dashboard;
}
