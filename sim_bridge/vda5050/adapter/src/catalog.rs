//! The actions of the driver, and the work of the vehicle that performs them.

use consort_vda5050_core::{BlockingType, Work, fingerprint};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// The standard action that drives.
const DRIVE: &str = "navigate_to_pose";

/// Distance within which a pose is at a place, in metres, as in the node.
const AT_PLACE_M: f64 = 0.25;

/// A place and its node.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceForm {
    /// Id of the node in the vehicle's layout.
    pub node: String,
    /// East of the map's origin, in metres.
    pub x_m: f64,
    /// North of the map's origin, in metres.
    pub y_m: f64,
    /// Heading on arrival in radians.
    #[serde(default)]
    pub yaw_rad: Option<f64>,
}

/// Where an action of a vehicle belongs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScopeForm {
    /// An order with the action on the node where the vehicle is.
    #[default]
    Node,
    /// An instant action.
    Instant,
}

/// An action of the driver.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionForm {
    /// `actionType` of the vehicle's action.
    #[serde(rename = "type")]
    pub kind: String,
    /// What the action excludes.
    #[serde(default)]
    pub blocking: BlockingType,
    /// Where the action belongs.
    #[serde(default)]
    pub scope: ScopeForm,
    /// Parameters of the vehicle's action, by key. `{NAME}` stands for a parameter of the goal.
    #[serde(default)]
    pub parameters: BTreeMap<String, Value>,
    /// Name of the result that contains the vehicle's description of its result.
    #[serde(default)]
    pub result: Option<String>,
    /// Parameters of a goal with which `consort driver check` tries the action.
    #[serde(default)]
    pub example: Option<Map<String, Value>>,
}

/// Places and actions of a vehicle.
#[derive(Debug, Clone)]
pub struct Catalog {
    places: BTreeMap<String, PlaceForm>,
    actions: BTreeMap<String, ActionForm>,
}

/// An action of the file is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CatalogError {
    /// Place in the file.
    pub place: String,
    /// The problem, and what is allowed.
    pub problem: String,
}

/// A goal was rejected: nothing of it was sent to the vehicle.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct GoalError {
    /// Code of the cause.
    pub code: &'static str,
    /// Message for people.
    pub message: String,
}

impl Catalog {
    /// Creates a catalog.
    ///
    /// # Errors
    /// An action has a reserved name, or an empty type.
    pub fn new(
        places: BTreeMap<String, PlaceForm>,
        actions: BTreeMap<String, ActionForm>,
    ) -> Result<Catalog, CatalogError> {
        for (name, form) in &actions {
            let problem = if name == DRIVE {
                "the driver drives by orders; allowed is any other name".to_owned()
            } else if form.kind.is_empty() {
                "`type` is empty; allowed is an actionType of the vehicle, such as pick".to_owned()
            } else {
                continue;
            };
            return Err(CatalogError { place: format!("actions.{name}"), problem });
        }
        Ok(Catalog { places, actions })
    }

    /// Returns the place of a node.
    pub fn place_of(&self, node: &str) -> Option<&str> {
        self.places.iter().find(|(_, place)| place.node == node).map(|(name, _)| name.as_str())
    }

    /// Returns the places, with their nodes.
    pub fn places(&self) -> impl Iterator<Item = (&str, &PlaceForm)> {
        self.places.iter().map(|(name, place)| (name.as_str(), place))
    }

    /// Returns the actions, with their forms.
    pub fn actions(&self) -> impl Iterator<Item = (&str, &ActionForm)> {
        self.actions.iter().map(|(name, form)| (name.as_str(), form))
    }

    /// Returns the name of the result of an action.
    pub fn result_of(&self, action: &str) -> Option<&str> {
        self.actions.get(action)?.result.as_deref()
    }

    /// Returns the actions of the hello.
    pub fn offered(&self) -> Value {
        let mut offered = Map::new();
        let mut drive = json!({ "description": "drives to a place by orders of VDA 5050" });
        // A drive there is an example only if the vehicle is elsewhere: the last place.
        if let Some((name, place)) = self.places.iter().next_back() {
            drive["example"] = json!({ "place": name, "pose": { "x_m": place.x_m, "y_m": place.y_m } });
        }
        offered.insert(DRIVE.to_owned(), drive);
        for (name, form) in &self.actions {
            let scope = if form.scope == ScopeForm::Instant { "instant action" } else { "action" };
            let description =
                format!("executes the {scope} {} of the vehicle, blocking type {}", form.kind, form.blocking.as_str());
            let mut action = json!({ "description": description });
            if let Some(example) = &form.example {
                action["example"] = Value::Object(example.clone());
            }
            offered.insert(name.clone(), action);
        }
        Value::Object(offered)
    }

    /// Returns the work of a goal, and its fingerprint.
    ///
    /// # Errors
    /// The action, a place or a parameter is unknown.
    pub fn work(&self, action: &str, parameters: &Map<String, Value>) -> Result<(u32, Work), GoalError> {
        let work = if action == DRIVE { self.drive(parameters)? } else { self.act(action, parameters)? };
        // A map has its keys in order, so equal goals have equal texts. The limit of the speed may
        // change while a drive goes on, so the fingerprint of a drive is that of its target.
        let text = match &work {
            Work::Drive { to, .. } => format!("{DRIVE} {to}"),
            Work::Act { .. } => format!("{action} {}", json!(BTreeMap::from_iter(parameters))),
        };
        Ok((fingerprint(&text), work))
    }

    fn drive(&self, parameters: &Map<String, Value>) -> Result<Work, GoalError> {
        let named = parameters.get("place").and_then(Value::as_str).and_then(|name| self.places.get(name));
        let pose = |key: &str| parameters.get("pose").and_then(|pose| pose[key].as_f64());
        let at_pose = || {
            let (x_m, y_m) = pose("x_m").zip(pose("y_m"))?;
            self.places.values().find(|place| (place.x_m - x_m).hypot(place.y_m - y_m) <= AT_PLACE_M)
        };
        let place = named.or_else(at_pose).ok_or_else(|| {
            let known: Vec<&str> = self.places.keys().map(String::as_str).collect();
            let asked = json!(parameters);
            let message = format!("{DRIVE}: {asked} is no place of the vehicle; allowed: {}", known.join(", "));
            GoalError { code: "no_route", message }
        })?;
        let speed_max_mps = parameters.get("speed_max_mps").and_then(Value::as_f64);
        Ok(Work::Drive { to: place.node.clone(), speed_max_mps })
    }

    fn act(&self, action: &str, parameters: &Map<String, Value>) -> Result<Work, GoalError> {
        let form = self.actions.get(action).ok_or_else(|| {
            let known: Vec<&str> = self.actions.keys().map(String::as_str).chain([DRIVE]).collect();
            let message = format!("the action {action} is not offered; allowed: {}", known.join(", "));
            GoalError { code: "unknown", message }
        })?;
        let filled = form.parameters.iter().filter_map(|(key, form)| Some((key.clone(), fill(form, parameters)?)));
        Ok(Work::Act {
            kind: form.kind.clone(),
            blocking: form.blocking,
            parameters: filled.collect(),
            is_instant: form.scope == ScopeForm::Instant,
        })
    }
}

/// Returns a parameter of the vehicle: `{NAME}` alone is the value of a parameter of the goal, and
/// inside a text its text. A value whose parameter the goal does not have is left out.
pub(crate) fn fill(form: &Value, parameters: &Map<String, Value>) -> Option<Value> {
    let Some(text) = form.as_str() else { return Some(form.clone()) };
    if let Some(name) = text.strip_prefix('{').and_then(|text| text.strip_suffix('}')) {
        return parameters.get(name).cloned();
    }
    let filled = parameters.iter().fold(text.to_owned(), |text, (name, value)| {
        let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        text.replace(&format!("{{{name}}}"), &value)
    });
    Some(Value::String(filled))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn catalog() -> Catalog {
        let places = json!({ "Dock": { "node": "n1", "x_m": 0.0, "y_m": 0.0 }, "Ward": { "node": "n2", "x_m": 5.0, "y_m": 0.0 } });
        let actions = json!({ "pick_load": {
            "type": "pick", "blocking": "HARD", "parameters": { "loadId": "{load}", "label": "load {load}", "height": 0.5, "side": "{side}" },
        } });
        Catalog::new(serde_json::from_value(places).unwrap(), serde_json::from_value(actions).unwrap()).unwrap()
    }

    fn map(value: Value) -> Map<String, Value> {
        value.as_object().unwrap().clone()
    }

    #[test]
    fn a_drive_goes_to_the_node_of_the_place_or_of_the_pose() {
        let catalog = catalog();
        let by_name =
            catalog.work(DRIVE, &map(json!({ "place": "Ward", "pose": { "x_m": 5.0, "y_m": 0.0 } }))).unwrap();
        let by_pose =
            catalog.work(DRIVE, &map(json!({ "pose": { "x_m": 5.1, "y_m": 0.0 }, "speed_max_mps": 0.3 }))).unwrap();
        assert_eq!(by_name.1, Work::Drive { to: "n2".to_owned(), speed_max_mps: None });
        assert_eq!(by_pose.1, Work::Drive { to: "n2".to_owned(), speed_max_mps: Some(0.3) });
        assert_eq!(by_name.0, by_pose.0, "a limit of the speed does not change the identity of a drive");
        let error = catalog.work(DRIVE, &map(json!({ "pose": { "x_m": 9.0, "y_m": 9.0 } }))).unwrap_err();
        assert_eq!(error.code, "no_route");
        assert!(error.message.contains("allowed: Dock, Ward"), "{error}");
    }

    #[test]
    fn parameters_of_a_goal_fill_those_of_the_action() {
        let (_, work) = catalog().work("pick_load", &map(json!({ "load": 7 }))).unwrap();
        let Work::Act { parameters, blocking, is_instant, .. } = work else { panic!("an action") };
        let expected = [("height", json!(0.5)), ("label", json!("load 7")), ("loadId", json!(7))];
        assert_eq!(parameters, BTreeMap::from(expected.map(|(key, value)| (key.to_owned(), value))));
        assert_eq!((blocking, is_instant), (BlockingType::Hard, false));
        let error = catalog().work("drop", &Map::new()).unwrap_err();
        assert!(error.message.contains("allowed: pick_load, navigate_to_pose"), "{error}");
    }

    #[test]
    fn the_hello_states_the_blocking_type() {
        let offered = catalog().offered();
        let text = offered["pick_load"]["description"].as_str().unwrap();
        assert_eq!(text, "executes the action pick of the vehicle, blocking type HARD");
    }
}
