//! One function for each thing that is read from others: it reads the bytes as the program does, and panics if what must hold
//! then does not. Two run them: the test beside this folder, with seeds and seeded changes of them, and cargo-fuzz (`tests/fuzz/`).
//!
//! What must hold beyond ending without a panic, soon and in little memory: what was read can be written, and what is written
//! reads back the same; what an importer has taken passes its own checks; what is refused is refused with words.

mod behavior_files;
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

/// Something that is read.
pub(crate) struct Target {
    /// Its name: that of the fuzz target, and of its folder of kept inputs.
    pub(crate) name: &'static str,
    /// Reads; says whether anything of it made sense.
    pub(crate) run: fn(&[u8]) -> bool,
}

macro_rules! targets {
    ($($(#[doc = $doc:literal])* $name:ident = $hit:path;)*) => {
        /// All there are.
        pub(crate) const ALL: &[Target] = &[$(Target { name: stringify!($name), run: $hit }),*];
    };
}

targets! {
    /// Messages between nodes, of each kind.
    wire = messages::wire;
    /// The seal around them, and what whoever bears it may say.
    seal = trust::signed_envelope;
    /// Certificates as peers show them, and lists of revoked ones.
    certificate = trust::certificate;
    /// Certificates as files.
    pem = trust::pem;
    /// Names, identities and keys, which stand in keys and certificates.
    names = trust::names;
    /// Gossip: packets of failure detection, statements, exchanges, one after the other.
    gossip = messages::gossip;
    /// Consensus: questions, answers, log entries, snapshots.
    raft = messages::raft;
    /// What a robot is awarded, carried out.
    award = robots::award;
    /// A robot's notebook.
    notebook = robots::checkpoint;
    /// Commands of the ledger, one after the other.
    ledger = ledgers::ledger;
    /// A store on a disk that was damaged.
    store = stores::store;
    /// Requests of clients.
    request = missions::request;
    /// Missions in YAML.
    mission_yaml = missions::yaml;
    /// Missions in JSON.
    mission_json = missions::json;
    /// Missions in the flat form.
    ihtn = missions::ihtn;
    /// Our own maps in YAML.
    map_yaml = maps::yaml;
    /// Our own maps in JSON, and those of the published evaluation.
    map_json = maps::json;
    /// Drawings of diagrams.net.
    drawing = maps::drawing;
    /// Buildings of Open-RMF.
    building = maps::building;
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
    /// Workers, scenarios, results, measured legs and schedules of chaos.
    tables = settings::tables;
    /// Recordings.
    recording = recordings::recording;
    /// What is heard of a fleet by whoever shows it.
    picture = recordings::fleet_model;
    /// Requests to the dashboard.
    dashboard = recordings::dashboard;
}
