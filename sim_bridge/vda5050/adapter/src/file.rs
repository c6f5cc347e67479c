//! The file of a vehicle.

use crate::catalog::{ActionForm, Catalog, PlaceForm};
use consort_vda5050_core::{
    BlockingType, CauseTable, Layout, LayoutError, LayoutNode, MachineSettings, Vehicle, Version, class_of,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

/// Content of the file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleFile {
    /// The broker.
    pub broker: BrokerForm,
    /// First level of the topics.
    #[serde(default = "interface")]
    pub interface: String,
    /// Version of the protocol that the vehicle implements.
    pub version: String,
    /// Manufacturer, as in the topics of the vehicle.
    pub manufacturer: String,
    /// Serial number, as in the topics of the vehicle.
    pub serial: String,
    /// Map of the positions (`mapId`).
    pub map: String,
    /// Places of the fleet's map and their nodes.
    pub places: BTreeMap<String, PlaceForm>,
    /// Further nodes, between the places.
    #[serde(default)]
    pub nodes: BTreeMap<String, NodeForm>,
    /// Edges between nodes, in both directions. Without edges the vehicle finds its way between any
    /// two nodes.
    #[serde(default)]
    pub edges: Vec<[String; 2]>,
    /// Number of nodes that are released ahead of the vehicle. Fewer leave the vehicle less to drive
    /// when the broker fails; more let it drive without pauses on slow links.
    #[serde(default = "release_ahead")]
    pub release_ahead: usize,
    /// Actions of the driver, by name, and the actions of the vehicle that perform them.
    #[serde(default)]
    pub actions: BTreeMap<String, ActionForm>,
    /// Codes of the vehicle's errors, by `errorType`.
    #[serde(default)]
    pub errors: BTreeMap<String, String>,
}

/// A broker.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrokerForm {
    /// `mqtt://HOST:PORT`, or `mqtts://HOST:PORT` with TLS.
    pub url: String,
    /// Name of the user.
    #[serde(default)]
    pub user: Option<String>,
    /// File with the password.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Certificates of the authorities that may sign the broker's certificate, in PEM. Default: those of
    /// the system.
    #[serde(default)]
    pub ca: Option<PathBuf>,
    /// Certificate of this client, in PEM. It needs `ca`.
    #[serde(default)]
    pub certificate: Option<PathBuf>,
    /// Key of that certificate, in PEM.
    #[serde(default)]
    pub key: Option<PathBuf>,
}

/// A node without a place.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeForm {
    /// East of the map's origin, in metres.
    pub x_m: f64,
    /// North of the map's origin, in metres.
    pub y_m: f64,
}

pub(crate) fn interface() -> String {
    "uagv".to_owned()
}

fn release_ahead() -> usize {
    2
}

/// The file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file, or a file that it names, cannot be read.
    #[error("{path}: {problem}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: io::Error,
    },
    /// The file is no YAML, or has other keys.
    #[error("{path}: {problem}")]
    Form {
        /// The file.
        path: PathBuf,
        /// The problem, with line and column.
        problem: String,
    },
    /// A value is wrong.
    #[error("{path}: {place}: {problem}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Place in the file: `broker.url`.
        place: String,
        /// The problem, and what is allowed.
        problem: String,
    },
}

/// Address of a broker and credentials.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokerAccess {
    /// Host.
    pub host: String,
    /// Port.
    pub port: u16,
    /// User and password.
    pub login: Option<(String, String)>,
    /// Settings of TLS; `None` without TLS.
    pub tls: Option<TlsAccess>,
}

/// Settings of TLS.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TlsAccess {
    /// Certificates of authorities in PEM; `None` for those of the system.
    pub ca: Option<Vec<u8>>,
    /// Certificate and key of the client in PEM.
    pub client: Option<(Vec<u8>, Vec<u8>)>,
}

/// A checked file.
#[derive(Debug, Clone)]
pub struct VehicleSettings {
    /// The vehicle.
    pub vehicle: Vehicle,
    /// The broker.
    pub broker: BrokerAccess,
    /// Places and actions.
    pub catalog: Catalog,
    /// Nodes and edges.
    pub layout: Layout,
    map: String,
    release_ahead: usize,
    causes: CauseTable,
}

impl VehicleSettings {
    /// Reads and checks a file. Names of files in it are relative to it.
    ///
    /// # Errors
    /// The first problem, with its place.
    pub fn read(path: &Path) -> Result<VehicleSettings, FileError> {
        let text = fs::read_to_string(path).map_err(|problem| FileError::Read { path: path.to_owned(), problem })?;
        VehicleSettings::parse(path, &text)
    }

    fn parse(path: &Path, text: &str) -> Result<VehicleSettings, FileError> {
        let file: VehicleFile = serde_saphyr::from_str(text)
            .map_err(|problem| FileError::Form { path: path.to_owned(), problem: problem.to_string() })?;
        let wrong =
            |place: &str, problem: String| FileError::Value { path: path.to_owned(), place: place.to_owned(), problem };
        let version: Version = file.version.parse().map_err(|problem| wrong("version", format!("{problem}")))?;
        let vehicle = Vehicle::new(&file.interface, version, &file.manufacturer, &file.serial)
            .map_err(|problem| wrong(problem.field, problem.to_string()))?;
        if file.places.is_empty() {
            return Err(wrong("places", "the list is empty; a driver needs a place to drive to".to_owned()));
        }
        if file.release_ahead == 0 {
            return Err(wrong("release_ahead", "0 releases nothing; allowed is 1 or more".to_owned()));
        }
        if let Some((kind, code)) = file.errors.iter().find(|(_, code)| code.is_empty()) {
            return Err(wrong(
                &format!("errors.{kind}"),
                format!("{code:?} is no code; allowed: blocked, no_route, …"),
            ));
        }
        file.check_nodes().map_err(|(place, problem)| wrong(&place, problem))?;
        let is_single = |form: &ActionForm| form.blocking == BlockingType::Single && version != Version::V3_0;
        if let Some((name, _)) = file.actions.iter().find(|(_, form)| is_single(form)) {
            let problem = format!("SINGLE needs version 3.0; allowed in {version}: NONE, SOFT, HARD");
            return Err(wrong(&format!("actions.{name}.blocking"), problem));
        }
        let layout = file.layout().map_err(|problem| wrong("edges", problem.to_string()))?;
        let broker = file.broker.access(path)?;
        let catalog =
            Catalog::new(file.places, file.actions).map_err(|problem| wrong(&problem.place, problem.problem))?;
        let causes = CauseTable { by_type: file.errors };
        Ok(VehicleSettings {
            vehicle,
            broker,
            catalog,
            layout,
            map: file.map,
            release_ahead: file.release_ahead,
            causes,
        })
    }

    /// Returns the settings of the state machine.
    pub fn machine(&self, session: u64) -> MachineSettings {
        MachineSettings {
            layout: self.layout.clone(),
            map: self.map.clone(),
            release_ahead: self.release_ahead,
            causes: self.causes.clone(),
            retry_after: Duration::from_secs(2),
            ready_within: Duration::from_secs(10),
            silence_max: Duration::from_secs(35),
            adopt_within: Duration::from_secs(3),
            session,
        }
    }

    /// Returns the codes of errors that no standard class has: the domain has to declare them.
    pub fn own_codes(&self) -> impl Iterator<Item = &str> {
        self.causes.by_type.values().map(String::as_str).filter(|code| class_of(code).is_none())
    }
}

impl VehicleFile {
    /// Checks the coordinates, and that no node has two descriptions. An error is the place in the file,
    /// and the problem.
    fn check_nodes(&self) -> Result<(), (String, String)> {
        let of_places = self.places.iter().map(|(name, place)| (format!("places.{name}"), [place.x_m, place.y_m]));
        let of_nodes = self.nodes.iter().map(|(id, node)| (format!("nodes.{id}"), [node.x_m, node.y_m]));
        for (at, coordinates) in of_places.chain(of_nodes) {
            if !coordinates.iter().all(|coordinate| coordinate.is_finite()) {
                return Err((at, format!("{coordinates:?} is no position; allowed are finite numbers of metres")));
            }
        }
        for (name, place) in &self.places {
            if let Some(yaw_rad) = place.yaw_rad.filter(|yaw_rad| !(-PI..=PI).contains(yaw_rad)) {
                let problem = format!("{yaw_rad} is no heading; allowed are -3.1415 to 3.1415 radians");
                return Err((format!("places.{name}.yaw_rad"), problem));
            }
            if self.nodes.contains_key(&place.node) {
                let problem = format!("this is the node of the place {name}; allowed are nodes without a place");
                return Err((format!("nodes.{}", place.node), problem));
            }
            let is_elsewhere = |(_, other): &(&String, &PlaceForm)| {
                other.node == place.node && (other.x_m - place.x_m).hypot(other.y_m - place.y_m) > 0.0
            };
            if let Some((other, _)) = self.places.iter().find(is_elsewhere) {
                let problem =
                    format!("{:?} has another position in places.{other}; allowed is one for a node", place.node);
                return Err((format!("places.{name}.node"), problem));
            }
        }
        Ok(())
    }

    fn layout(&self) -> Result<Layout, LayoutError> {
        let of_places = self
            .places
            .values()
            .map(|place| (place.node.clone(), LayoutNode { x_m: place.x_m, y_m: place.y_m, yaw_rad: place.yaw_rad }));
        let others = self
            .nodes
            .iter()
            .map(|(id, node)| (id.clone(), LayoutNode { x_m: node.x_m, y_m: node.y_m, yaw_rad: None }));
        Layout::new(of_places.chain(others).collect(), &self.edges)
    }
}

impl BrokerForm {
    pub(crate) fn access(&self, path: &Path) -> Result<BrokerAccess, FileError> {
        let wrong = |place: &str, problem: String| FileError::Value {
            path: path.to_owned(),
            place: format!("broker.{place}"),
            problem,
        };
        let bytes = |name: &Path| {
            let path = path.parent().unwrap_or(Path::new("")).join(name);
            fs::read(&path).map_err(|problem| FileError::Read { path, problem })
        };
        let optional = |name: &Option<PathBuf>| name.as_deref().map(bytes).transpose();
        let form = || wrong("url", format!("{:?}; allowed: mqtt://HOST:PORT or mqtts://HOST:PORT", self.url));
        let (scheme, address) = self.url.split_once("://").ok_or_else(form)?;
        let address = address.trim_end_matches('/');
        let (has_tls, default_port) = match scheme {
            "mqtt" => (false, 1883),
            "mqtts" => (true, 8883),
            _ => return Err(form()),
        };
        let (host, port) = match address.rsplit_once(':') {
            Some((host, port)) => (host, port.parse().map_err(|_| form())?),
            None => (address, default_port),
        };
        if host.is_empty() || host.contains(['/', '@']) {
            return Err(form());
        }
        if !has_tls && (self.ca.is_some() || self.certificate.is_some() || self.key.is_some()) {
            return Err(wrong("url", format!("{:?} has no TLS; certificates need mqtts://", self.url)));
        }
        let client = match (optional(&self.certificate)?, optional(&self.key)?) {
            (Some(certificate), Some(key)) => Some((certificate, key)),
            (None, None) => None,
            _ => {
                return Err(wrong(
                    "certificate",
                    "a certificate needs its `key`, and a key its certificate".to_owned(),
                ));
            }
        };
        if client.is_some() && self.ca.is_none() {
            return Err(wrong("ca", "the key is missing; a `certificate` of the client needs it".to_owned()));
        }
        // The end of the line is no part of the password; a space may be.
        let line = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).trim_end_matches(['\r', '\n']).to_owned();
        let password = optional(&self.password_file)?.map(line);
        let login = match (&self.user, password) {
            (Some(user), password) => Some((user.clone(), password.unwrap_or_default())),
            (None, Some(_)) => return Err(wrong("password_file", "a password needs its `user`".to_owned())),
            (None, None) => None,
        };
        let tls = has_tls.then_some(TlsAccess { ca: optional(&self.ca)?, client });
        Ok(BrokerAccess { host: host.to_owned(), port, login, tls })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the error of a file: the smallest one, in which a text is replaced.
    fn error(part: &str, other: &str) -> String {
        let text = "\
broker: { url: \"mqtt://127.0.0.1:1883\" }
version: \"2.0\"
manufacturer: ACME
serial: \"7\"
map: ward
places:
  Dock: { node: n1, x_m: 0, y_m: 0 }
  Ward: { node: n2, x_m: 5, y_m: 0 }
";
        let path = Path::new("vehicle.yaml");
        assert!(VehicleSettings::parse(path, text).is_ok());
        assert!(text.contains(part), "{part}");
        VehicleSettings::parse(path, &text.replace(part, other)).unwrap_err().to_string()
    }

    #[test]
    fn an_error_names_the_file_the_place_and_what_is_allowed() {
        let cases = [
            ("\"2.0\"", "\"1.1\"", "version: ", "allowed: \"2.0\", \"2.1\", \"3.0\""),
            ("ACME", "AC/ME", "manufacturer: ", "allowed is a text without"),
            ("mqtt://", "http://", "broker.url: ", "allowed: mqtt://HOST:PORT"),
            ("1883\"", "1883\", ca: ca.pem", "broker.url: ", "certificates need mqtts://"),
            ("1883\"", "1883\", password_file: missing", "missing: ", "No such file"),
            ("x_m: 5", "x_m: .nan", "places.Ward: ", "allowed are finite numbers"),
            ("x_m: 5", "yaw_rad: 4, x_m: 5", "places.Ward.yaw_rad: 4 is no heading", "allowed are -3.1415 to 3.1415"),
            ("n2", "n1", "places.Dock.node: ", "another position in places.Ward"),
            (
                "map: ward",
                "map: ward\nnodes: { n2: { x_m: 1, y_m: 1 } }",
                "nodes.n2: ",
                "allowed are nodes without a place",
            ),
            ("map: ward", "map: ward\nedges: [[n1, n9]]", "edges[0]: no node \"n9\"", "allowed are the nodes of"),
            (
                "map: ward",
                "map: ward\nactions: { pick: { type: pick, blocking: SINGLE } }",
                "actions.pick.blocking: ",
                "NONE, SOFT, HARD",
            ),
            ("map: ward", "map: ward\nrelease_ahead: 0", "release_ahead: ", "allowed is 1 or more"),
        ];
        for (part, other, place, allowed) in cases {
            let text = error(part, other);
            assert!(text.contains(place) && text.contains(allowed), "{other}: {text}");
            assert!(text.starts_with("vehicle.yaml: ") || place == "missing: ", "{text}");
        }
    }
}
