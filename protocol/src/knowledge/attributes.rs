//! Attributes of robots: values that policies of a fleet use.

use crate::scalar::{NamedScalarsError, Scalar, check_named_scalars};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Maximum number of attributes of a robot.
const ATTRIBUTES_MAX: usize = 32;

/// Attributes of a robot, such as `section = "icu"`, by name. A name consists of letters, digits and
/// `_`, and does not begin with a digit, so that conditions can use it as `robot.attributes.section`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "BTreeMap<String, Scalar>")]
#[schemars(with = "BTreeMap<String, Scalar>")]
pub struct Attributes(BTreeMap<String, Scalar>);

impl Attributes {
    /// Checks whether there is no attribute.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the attributes in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = (&String, &Scalar)> {
        self.0.iter()
    }

    /// Removes the attributes with names that do not fit.
    pub(crate) fn retain(&mut self, fits: impl Fn(&str) -> bool) {
        self.0.retain(|name, _| fits(name));
    }
}

impl TryFrom<BTreeMap<String, Scalar>> for Attributes {
    type Error = NamedScalarsError;

    fn try_from(values: BTreeMap<String, Scalar>) -> Result<Attributes, NamedScalarsError> {
        check_named_scalars("attribute", &values, ATTRIBUTES_MAX)?;
        Ok(Attributes(values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(json: serde_json::Value) -> Result<Attributes, String> {
        serde_json::from_value(json).map_err(|error| error.to_string())
    }

    #[test]
    fn attributes_keep_the_type_of_their_values() {
        let json = serde_json::json!({ "section": "icu", "payload_kg": 2.5, "floor": 3, "sterile": true });
        let attributes = parse(json.clone()).unwrap();
        assert_eq!(serde_json::to_value(&attributes).unwrap(), json);
        let bytes = crate::codec::encode(&attributes).unwrap();
        assert_eq!(crate::codec::decode::<Attributes>(&bytes).unwrap(), attributes);
    }

    #[test]
    fn invalid_attributes_are_rejected_with_the_rule() {
        let many: serde_json::Map<_, _> = (0..33).map(|number| (format!("a{number}"), number.into())).collect();
        for (json, part) in [
            (serde_json::json!({ "floor-3": true }), "`floor-3` has an invalid name; allowed are"),
            (serde_json::json!({ "3rd": true }), "no digit at the beginning"),
            (serde_json::json!({ "": true }), "invalid name"),
            (serde_json::json!({ "note": "x".repeat(257) }), "`note` is a text of 257 bytes; at most 256"),
            (serde_json::json!({ "sections": ["icu"] }), "allowed is a boolean, a number or a text"),
            (many.into(), "33 attributes; at most 32 are allowed"),
        ] {
            let error = parse(json).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
