//! Definitions of messages, services and actions, their parsing, and their RIHS01 hashes (REP-2016).
//!
//! The hash of a type is part of every key on the graph. A type whose hash on the graph differs from
//! that of its shipped definition is therefore another type; its definition can be requested from the
//! node that uses it ([`TypeRegistry::add_description`]).

use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};

/// The shipped definitions.
const JAZZY: &str = include_str!("../../types/jazzy.txt");

/// Deepest nesting of messages.
const DEPTH_MAX: usize = 16;

/// Field of a message without fields, which CDR and the hash contain.
const EMPTY_FIELD: &str = "structure_needs_at_least_one_member";

/// Primitive types with their number in `type_description_interfaces/msg/FieldType`.
const PRIMITIVES: [(&str, Primitive, u8); 15] = [
    ("int8", Primitive::Int { bytes: 1, signed: true }, 2),
    ("uint8", Primitive::Int { bytes: 1, signed: false }, 3),
    ("int16", Primitive::Int { bytes: 2, signed: true }, 4),
    ("uint16", Primitive::Int { bytes: 2, signed: false }, 5),
    ("int32", Primitive::Int { bytes: 4, signed: true }, 6),
    ("uint32", Primitive::Int { bytes: 4, signed: false }, 7),
    ("int64", Primitive::Int { bytes: 8, signed: true }, 8),
    ("uint64", Primitive::Int { bytes: 8, signed: false }, 9),
    ("float32", Primitive::Float32, 10),
    ("float64", Primitive::Float64, 11),
    // rosidl reads `char` as `uint8`.
    ("char", Primitive::Int { bytes: 1, signed: false }, 3),
    ("bool", Primitive::Bool, 15),
    ("byte", Primitive::Int { bytes: 1, signed: false }, 16),
    ("string", Primitive::Text, 17),
    ("char_of_idl", Primitive::Int { bytes: 1, signed: false }, 13),
];

/// A primitive type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Primitive {
    /// `bool`.
    Bool,
    /// A whole number.
    Int {
        /// Size.
        bytes: u8,
        /// True if it may be negative.
        signed: bool,
    },
    /// `float32`.
    Float32,
    /// `float64`.
    Float64,
    /// `string`.
    Text,
}

/// Type of a field, without its number of values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Base {
    /// A primitive type, with its number in a type description.
    Primitive(Primitive, u8),
    /// Another message, by name.
    Message(String),
}

/// Number of values of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A single value.
    Single,
    /// An array with this length.
    Array(usize),
    /// A list, with its greatest length if it has one.
    Sequence(Option<usize>),
}

/// A field of a message.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Name.
    pub name: String,
    /// Type of a value.
    pub base: Base,
    /// Number of values.
    pub shape: Shape,
    /// Greatest length of a text; 0 without a limit.
    pub text_max: u64,
    /// Default value; the zero of the type without one.
    pub default: Option<Value>,
}

/// A definition cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TypeError {
    /// There is no definition of this name.
    #[error("the type {0} is unknown: neither is it shipped, nor do `types` define it, nor does a node describe it")]
    Unknown(String),
    /// A line of a definition cannot be read.
    #[error("{place}: {line:?} is no field; allowed is a type and a name, as \"float32[] ranges\"")]
    Line {
        /// The type, or the file.
        place: String,
        /// The line.
        line: String,
    },
    /// A name has not the form `package/msg/Name`.
    #[error("{0:?} is no name of a type; allowed is package/msg/Name, package/srv/Name or package/action/Name")]
    Name(String),
    /// A type contains itself, or its nesting is too deep.
    #[error("the type {0} is nested too deep")]
    Depth(String),
    /// A description of a node has a type that this program cannot read.
    #[error("the description of {name} has a field of the type number {number}, which this program cannot read")]
    Number {
        /// The message.
        name: String,
        /// The number.
        number: u64,
    },
    /// A description of a node has not the announced hash.
    #[error("the description of {name} has the hash {found} instead of {expected}")]
    Hash {
        /// The message.
        name: String,
        /// Hash on the graph.
        expected: String,
        /// Hash of the description.
        found: String,
    },
    /// A description lacks a part.
    #[error("the description of {0} is malformed")]
    Malformed(String),
}

/// Definitions by name.
#[derive(Debug, Clone, Default)]
pub struct TypeRegistry {
    messages: BTreeMap<String, Vec<Field>>,
}

impl TypeRegistry {
    /// Returns the shipped definitions.
    ///
    /// # Panics
    /// Never: the shipped definitions are valid.
    pub fn shipped() -> TypeRegistry {
        let mut registry = TypeRegistry::default();
        let mut definitions: Vec<(&str, String)> = vec![];
        for line in JAZZY.lines() {
            match line.strip_prefix("= ") {
                Some(name) => definitions.push((name, String::new())),
                None => {
                    if let Some((_, text)) = definitions.last_mut() {
                        text.push_str(line);
                        text.push('\n');
                    }
                }
            }
        }
        for (name, text) in definitions {
            registry.define(name, &text).expect("the shipped definitions are valid");
        }
        registry
    }

    /// Adds a message, a service or an action from the text of its file. It replaces a definition of the
    /// same name.
    ///
    /// # Errors
    /// [`TypeError`] of the name or a line.
    pub fn define(&mut self, name: &str, text: &str) -> Result<(), TypeError> {
        let (package, kind) = name_parts(name)?;
        let mut parts = vec![vec![]];
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line == "---" {
                parts.push(vec![]);
            } else if !line.is_empty() && !is_constant(line) {
                let field = parse_field(package, line)
                    .ok_or_else(|| TypeError::Line { place: name.to_owned(), line: line.to_owned() })?;
                parts.last_mut().expect("there is a part").push(field);
            }
        }
        parts.resize(
            match kind {
                "msg" => 1,
                "srv" => 2,
                _ => 3,
            },
            vec![],
        );
        let mut parts = parts.into_iter();
        let mut next = || parts.next().unwrap_or_default();
        match kind {
            "msg" => self.insert(name, next()),
            "srv" => {
                let (request, response) = (next(), next());
                self.insert_service(name, request, response);
            }
            _ => {
                for part in ["Goal", "Result", "Feedback"] {
                    self.insert(&format!("{name}_{part}"), next());
                }
                self.insert_action_parts(name);
            }
        }
        Ok(())
    }

    fn insert(&mut self, name: &str, mut fields: Vec<Field>) {
        if fields.is_empty() {
            fields.extend(parse_field("", &format!("uint8 {EMPTY_FIELD}")));
        }
        self.messages.insert(name.to_owned(), fields);
    }

    fn insert_service(&mut self, name: &str, request: Vec<Field>, response: Vec<Field>) {
        self.insert(&format!("{name}_Request"), request);
        self.insert(&format!("{name}_Response"), response);
        let event = [
            message("info", "service_msgs/msg/ServiceEventInfo", Shape::Single),
            message("request", &format!("{name}_Request"), Shape::Sequence(Some(1))),
            message("response", &format!("{name}_Response"), Shape::Sequence(Some(1))),
        ];
        self.insert(&format!("{name}_Event"), event.into());
        let parts = ["Request", "Response", "Event"];
        let field =
            |part: &str| message(&format!("{}_message", part.to_lowercase()), &format!("{name}_{part}"), Shape::Single);
        self.insert(name, parts.map(field).into());
    }

    fn insert_action_parts(&mut self, name: &str) {
        let id = || message("goal_id", "unique_identifier_msgs/msg/UUID", Shape::Single);
        let of = |part: &str, kind: &str| message(part, &format!("{name}_{kind}"), Shape::Single);
        let plain = |line: &str| parse_field("", line).expect("a valid line");
        let accepted = vec![plain("bool accepted"), message("stamp", "builtin_interfaces/msg/Time", Shape::Single)];
        self.insert_service(&format!("{name}_SendGoal"), vec![id(), of("goal", "Goal")], accepted);
        let result = vec![plain("int8 status"), of("result", "Result")];
        self.insert_service(&format!("{name}_GetResult"), vec![id()], result);
        self.insert(&format!("{name}_FeedbackMessage"), vec![id(), of("feedback", "Feedback")]);
    }

    /// Adds the type of a `type_description_interfaces/msg/TypeDescription`, with the types that it
    /// contains, if it has the hash.
    ///
    /// # Errors
    /// [`TypeError`]; the registry is unchanged.
    pub fn add_description(&mut self, description: &Value, hash: &str) -> Result<(), TypeError> {
        let main = &description["type_description"];
        let name = main["type_name"].as_str().unwrap_or_default().to_owned();
        let others = description["referenced_type_descriptions"].as_array().cloned().unwrap_or_default();
        let mut added = self.clone();
        for part in others.iter().chain([main]) {
            let part_name = part["type_name"].as_str().ok_or_else(|| TypeError::Malformed(name.clone()))?;
            let fields = part["fields"].as_array().ok_or_else(|| TypeError::Malformed(name.clone()))?;
            let fields = fields.iter().map(|field| described_field(part_name, field)).collect::<Result<_, _>>()?;
            added.messages.insert(part_name.to_owned(), fields);
        }
        let found = added.hash(&name)?;
        if found != hash {
            return Err(TypeError::Hash { name, expected: hash.to_owned(), found });
        }
        *self = added;
        Ok(())
    }

    /// Returns the fields of a message.
    ///
    /// # Errors
    /// [`TypeError::Unknown`].
    pub fn fields(&self, name: &str) -> Result<&[Field], TypeError> {
        self.messages.get(name).map(Vec::as_slice).ok_or_else(|| TypeError::Unknown(name.to_owned()))
    }

    /// Checks whether a message, a service or an action is defined.
    pub fn defines(&self, name: &str) -> bool {
        self.messages.contains_key(name) || self.messages.contains_key(&format!("{name}_Goal"))
    }

    /// Returns the names of all messages and services, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.messages.keys().map(String::as_str)
    }

    /// Returns the RIHS01 hash of a message or a service.
    ///
    /// # Errors
    /// [`TypeError::Unknown`] if it, or a type that it contains, is unknown.
    pub fn hash(&self, name: &str) -> Result<String, TypeError> {
        let mut contained = BTreeSet::new();
        self.collect_contained(name, &mut contained, 0)?;
        let main = self.described(name)?;
        let others = contained.iter().map(|name| self.described(name)).collect::<Result<Vec<_>, _>>()?;
        let json =
            format!("{{\"type_description\": {main}, \"referenced_type_descriptions\": [{}]}}", others.join(", "));
        let digest = Sha256::digest(json);
        Ok(digest.iter().fold("RIHS01_".to_owned(), |text, byte| format!("{text}{byte:02x}")))
    }

    fn collect_contained(&self, name: &str, found: &mut BTreeSet<String>, depth: usize) -> Result<(), TypeError> {
        if depth > DEPTH_MAX {
            return Err(TypeError::Depth(name.to_owned()));
        }
        for field in self.fields(name)? {
            if let Base::Message(contained) = &field.base
                && found.insert(contained.clone())
            {
                self.collect_contained(contained, found, depth + 1)?;
            }
        }
        Ok(())
    }

    fn described(&self, name: &str) -> Result<String, TypeError> {
        let fields = self.fields(name)?.iter().map(|field| {
            let (offset, capacity) = match field.shape {
                Shape::Single => (0, 0),
                Shape::Array(length) => (48, length),
                Shape::Sequence(Some(length)) => (96, length),
                Shape::Sequence(None) => (144, 0),
            };
            let (number, nested) = match &field.base {
                Base::Primitive(Primitive::Text, number) if field.text_max > 0 => (number + 4, ""),
                Base::Primitive(_, number) => (*number, ""),
                Base::Message(nested) => (1, nested.as_str()),
            };
            format!(
                "{{\"name\": \"{}\", \"type\": {{\"type_id\": {}, \"capacity\": {capacity}, \"string_capacity\": {}, \
                 \"nested_type_name\": \"{nested}\"}}}}",
                field.name,
                number + offset,
                field.text_max
            )
        });
        Ok(format!("{{\"type_name\": \"{name}\", \"fields\": [{}]}}", fields.collect::<Vec<_>>().join(", ")))
    }
}

/// Returns the package and the kind of a name: `msg`, `srv` or `action`.
fn name_parts(name: &str) -> Result<(&str, &str), TypeError> {
    let parts: Vec<&str> = name.split('/').collect();
    match parts[..] {
        [package, kind @ ("msg" | "srv" | "action"), last] if !package.is_empty() && !last.is_empty() => {
            Ok((package, kind))
        }
        _ => Err(TypeError::Name(name.to_owned())),
    }
}

/// Returns the name of a type in keys and tokens: `nav2_msgs::action::dds_::Spin_SendGoal_`.
pub fn dds_name(name: &str) -> String {
    let mut parts = name.split('/');
    let mut next = || parts.next().unwrap_or_default();
    format!("{}::{}::dds_::{}_", next(), next(), next())
}

/// Returns the name of a type from its name in keys and tokens.
pub fn ros_name(dds_name: &str) -> String {
    let name = dds_name.replace("::dds_::", "::").replace("::", "/");
    name.strip_suffix('_').unwrap_or(&name).to_owned()
}

fn message(name: &str, kind: &str, shape: Shape) -> Field {
    Field { name: name.to_owned(), base: Base::Message(kind.to_owned()), shape, text_max: 0, default: None }
}

fn is_constant(line: &str) -> bool {
    let mut words = line.splitn(2, char::is_whitespace);
    let rest = words.nth(1).unwrap_or_default().trim();
    let name = rest.split(|letter: char| letter == '=' || letter.is_whitespace()).next().unwrap_or_default();
    rest[name.len()..].trim_start().starts_with('=')
}

fn parse_field(package: &str, line: &str) -> Option<Field> {
    let (kind, rest) = line.split_once(char::is_whitespace)?;
    let rest = rest.trim();
    let (name, default) = match rest.split_once(char::is_whitespace) {
        Some((name, default)) => (name, Some(default_value(default.trim()))),
        None => (rest, None),
    };
    let (kind, shape) = match kind.strip_suffix(']').and_then(|kind| kind.rsplit_once('[')) {
        None => (kind, Shape::Single),
        Some((kind, "")) => (kind, Shape::Sequence(None)),
        Some((kind, size)) => match size.strip_prefix("<=") {
            Some(most) => (kind, Shape::Sequence(Some(most.parse().ok()?))),
            None => (kind, Shape::Array(size.parse().ok()?)),
        },
    };
    let (kind, text_max) = match kind.split_once("<=") {
        Some((kind, most)) => (kind, most.parse().ok()?),
        None => (kind, 0),
    };
    let base = match PRIMITIVES.iter().find(|(name, ..)| *name == kind) {
        Some((_, primitive, number)) => Base::Primitive(*primitive, *number),
        None => Base::Message(match kind.split('/').collect::<Vec<_>>()[..] {
            [name] if name.starts_with(char::is_uppercase) => format!("{package}/msg/{name}"),
            [package, name] => format!("{package}/msg/{name}"),
            [_, _, _] => kind.to_owned(),
            _ => return None,
        }),
    };
    Some(Field { name: name.to_owned(), base, shape, text_max, default })
}

fn default_value(text: &str) -> Value {
    let plain = text.trim_matches(['"', '\'']);
    match text {
        "True" => Value::Bool(true),
        "False" => Value::Bool(false),
        _ => serde_json::from_str(text).unwrap_or_else(|_| Value::from(plain)),
    }
}

fn described_field(message: &str, field: &Value) -> Result<Field, TypeError> {
    let malformed = || TypeError::Malformed(message.to_owned());
    let name = field["name"].as_str().ok_or_else(malformed)?.to_owned();
    let kind = &field["type"];
    let number = kind["type_id"].as_u64().ok_or_else(malformed)?;
    let capacity = kind["capacity"].as_u64().and_then(|capacity| usize::try_from(capacity).ok()).unwrap_or_default();
    let text_max = kind["string_capacity"].as_u64().unwrap_or_default();
    let (shape, base) = match number {
        0..48 => (Shape::Single, number),
        48..96 => (Shape::Array(capacity), number - 48),
        96..144 => (Shape::Sequence(Some(capacity)), number - 96),
        _ => (Shape::Sequence(None), number - 144),
    };
    let base = match base {
        1 => Base::Message(kind["nested_type_name"].as_str().ok_or_else(malformed)?.to_owned()),
        21 => Base::Primitive(Primitive::Text, 17),
        base => match PRIMITIVES.iter().find(|(.., number)| u64::from(*number) == base) {
            Some((_, primitive, number)) => Base::Primitive(*primitive, *number),
            None => return Err(TypeError::Number { name: message.to_owned(), number }),
        },
    };
    let default = field["default_value"].as_str().filter(|text| !text.is_empty()).map(default_value);
    Ok(Field { name, base, shape, text_max, default })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The hashes of `std_msgs/String` is printed in the design document of `rmw_zenoh`; those of
    /// `NavigateToPose` are verified by another implementation in `tests/ros2/type_hashes.rs`.
    #[test]
    fn shipped_definitions_have_the_published_hashes() {
        let types = TypeRegistry::shipped();
        for (name, hash) in [
            ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
            (
                "nav2_msgs/action/NavigateToPose_SendGoal",
                "RIHS01_a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5",
            ),
            (
                "nav2_msgs/action/NavigateToPose_FeedbackMessage",
                "RIHS01_9d1f6fa2eb975ce733b419ac2e97b134d8ff92b6478b6559feed9a50bdfd82b3",
            ),
            ("action_msgs/srv/CancelGoal", "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"),
        ] {
            assert_eq!(types.hash(name).unwrap(), hash, "{name}");
        }
    }

    #[test]
    fn every_shipped_type_is_complete() {
        let types = TypeRegistry::shipped();
        for name in types.messages.keys() {
            types.hash(name).unwrap_or_else(|problem| panic!("{name}: {problem}"));
        }
    }

    #[test]
    fn definitions_are_read_like_those_of_rosidl() {
        let mut types = TypeRegistry::shipped();
        let text = "uint8 OFF=0\nstring MODE = 'a b' # a constant\n\nstring<=8 mode \"slow\"\nbool on True # default\nPoint[<=2] path\n";
        types.define("geometry_msgs/msg/Test", text).unwrap();
        let fields = types.fields("geometry_msgs/msg/Test").unwrap();
        let names: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
        assert_eq!(names, ["mode", "on", "path"]);
        assert_eq!((fields[0].text_max, &fields[1].default), (8, &Some(Value::Bool(true))));
        assert_eq!(fields[2].shape, Shape::Sequence(Some(2)));
        assert_eq!(fields[2].base, Base::Message("geometry_msgs/msg/Point".to_owned()));
        assert!(types.define("Test", "").unwrap_err().to_string().contains("package/msg/Name"));
        assert!(types.define("a/msg/B", "float64").unwrap_err().to_string().contains("is no field"));
    }

    #[test]
    fn a_description_of_a_node_counts_only_with_its_hash() {
        let mut types = TypeRegistry::shipped();
        let field = serde_json::json!({"name": "data", "default_value": "",
            "type": {"type_id": 17, "capacity": 0, "string_capacity": 0, "nested_type_name": ""}});
        let described = serde_json::json!({"type_description": {"type_name": "std_msgs/msg/String", "fields": [field]},
            "referenced_type_descriptions": []});
        let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        types.add_description(&described, hash).unwrap();
        let error = types.add_description(&described, "RIHS01_00").unwrap_err();
        assert!(matches!(error, TypeError::Hash { .. }), "{error}");
    }

    #[test]
    fn names_in_keys_convert_both_ways() {
        let dds = dds_name("nav2_msgs/action/Spin_SendGoal");
        assert_eq!(dds, "nav2_msgs::action::dds_::Spin_SendGoal_");
        assert_eq!(ros_name(&dds), "nav2_msgs/action/Spin_SendGoal");
    }
}
