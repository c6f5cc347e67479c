//! JSON schemas of the message types. Foxglove recognises them by name. The fields are those of
//! <https://docs.foxglove.dev/docs/sdk/schemas>.

use serde_json::{Value, json};

/// Schema of a message type.
pub struct Schema {
    name: &'static str,
    shape: Shape,
}

enum Shape {
    /// An object with these fields, all required.
    Fields(fn() -> Vec<Field>),
    /// A JSON Schema without its title.
    JsonSchema(fn() -> Value),
}

type Field = (&'static str, Value);

impl Schema {
    /// Creates a custom schema: its name, and its JSON Schema, an object.
    pub const fn new(name: &'static str, schema_fn: fn() -> Value) -> Schema {
        Schema { name, shape: Shape::JsonSchema(schema_fn) }
    }

    const fn known(name: &'static str, fields: fn() -> Vec<Field>) -> Schema {
        Schema { name, shape: Shape::Fields(fields) }
    }

    /// Name of the message type.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Returns the JSON Schema.
    pub(crate) fn describe(&self) -> Value {
        match self.shape {
            Shape::Fields(fields) => object(self.name, fields()),
            Shape::JsonSchema(schema_fn) => {
                let mut schema = schema_fn();
                schema["title"] = self.name.into();
                schema
            }
        }
    }
}

pub(super) static SCENE_UPDATE: Schema = Schema::known("foxglove.SceneUpdate", || {
    let kind = ("type", number("integer"));
    let deletion = object("foxglove.SceneEntityDeletion", vec![("timestamp", time()), kind, ("id", text())]);
    vec![("deletions", list(deletion)), ("entities", list(entity()))]
});

pub(super) static FRAME_TRANSFORMS: Schema = Schema::known("foxglove.FrameTransforms", || {
    let transform = vec![
        ("timestamp", time()),
        ("parent_frame_id", text()),
        ("child_frame_id", text()),
        ("translation", vector()),
        ("rotation", quaternion()),
    ];
    vec![("transforms", list(object("foxglove.FrameTransform", transform)))]
});

pub(super) static POSE_IN_FRAME: Schema =
    Schema::known("foxglove.PoseInFrame", || vec![("timestamp", time()), ("frame_id", text()), ("pose", pose())]);

pub(super) static LOG: Schema = Schema::known("foxglove.Log", || {
    vec![
        ("timestamp", time()),
        ("level", number("integer")),
        ("message", text()),
        ("name", text()),
        ("file", text()),
        ("line", number("integer")),
    ]
});

/// Custom schema: the state of a robot beyond its pose.
pub(super) static ROBOT_STATE: Schema = Schema::known("consort.RobotState", || {
    vec![
        ("timestamp", time()),
        ("place", text()),
        ("battery", number("number")),
        ("able", flag()),
        ("drawer_open", flag()),
        ("carries", list(text())),
    ]
});

fn entity() -> Value {
    let pair = object("foxglove.KeyValuePair", vec![("key", text()), ("value", text())]);
    let solid = |title, more: Vec<Field>| {
        let fields = [vec![("pose", pose())], more, vec![("color", colour())]].concat();
        list(object(title, fields))
    };
    let size = || vec![("size", vector())];
    let arrow = ["shaft_length", "shaft_diameter", "head_length", "head_diameter"].map(|name| (name, number("number")));
    let scales = ["bottom_scale", "top_scale"].map(|name| (name, number("number")));
    let mesh = || vec![("points", list(vector())), ("colors", list(colour())), ("indices", list(number("integer")))];
    let line =
        [vec![("type", number("integer")), ("thickness", number("number")), ("scale_invariant", flag())], mesh()];
    let label =
        vec![("billboard", flag()), ("font_size", number("number")), ("scale_invariant", flag()), ("text", text())];
    let model = vec![
        ("scale", vector()),
        ("override_color", flag()),
        ("url", text()),
        ("media_type", text()),
        ("data", text()),
    ];
    object(
        "foxglove.SceneEntity",
        vec![
            ("timestamp", time()),
            ("frame_id", text()),
            ("id", text()),
            ("lifetime", span("duration")),
            ("frame_locked", flag()),
            ("metadata", list(pair)),
            ("arrows", solid("foxglove.ArrowPrimitive", arrow.into())),
            ("cubes", solid("foxglove.CubePrimitive", size())),
            ("spheres", solid("foxglove.SpherePrimitive", size())),
            ("cylinders", solid("foxglove.CylinderPrimitive", [size(), scales.into()].concat())),
            ("lines", solid("foxglove.LinePrimitive", line.concat())),
            ("triangles", solid("foxglove.TriangleListPrimitive", mesh())),
            ("texts", solid("foxglove.TextPrimitive", label)),
            ("models", solid("foxglove.ModelPrimitive", model)),
        ],
    )
}

/// An object with all fields required.
fn object(title: &str, fields: Vec<Field>) -> Value {
    let required: Vec<&str> = fields.iter().map(|(name, _)| *name).collect();
    let properties: serde_json::Map<String, Value> =
        fields.iter().map(|(name, kind)| ((*name).to_owned(), kind.clone())).collect();
    json!({ "title": title, "type": "object", "properties": properties, "required": required })
}

fn list(items: Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn flag() -> Value {
    json!({ "type": "boolean" })
}

fn number(kind: &str) -> Value {
    json!({ "type": kind })
}

fn time() -> Value {
    span("time")
}

fn span(title: &str) -> Value {
    object(title, vec![("sec", number("integer")), ("nsec", number("integer"))])
}

fn numbers(title: &str, names: &[&'static str]) -> Value {
    object(title, names.iter().map(|name| (*name, number("number"))).collect())
}

fn vector() -> Value {
    numbers("foxglove.Vector3", &["x", "y", "z"])
}

fn quaternion() -> Value {
    numbers("foxglove.Quaternion", &["x", "y", "z", "w"])
}

fn colour() -> Value {
    numbers("foxglove.Color", &["r", "g", "b", "a"])
}

fn pose() -> Value {
    object("foxglove.Pose", vec![("position", vector()), ("orientation", quaternion())])
}
