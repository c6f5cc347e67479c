//! Rust types that ports can be read as and written from.

use super::value::{PortType, Value};
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::pose::Pose;
use consort_protocol::units::Seconds;

/// A Rust type that a port can be read as.
pub trait PortValue: Sized {
    /// The corresponding port type.
    const TYPE: PortType;

    /// Extracts a value of type [`Self::TYPE`]; `None` for any other.
    fn from_value(value: Value) -> Option<Self>;
}

macro_rules! port_values {
    ($($rust:ty, $variant:ident;)*) => {$(
        impl PortValue for $rust {
            const TYPE: PortType = PortType::$variant;
            fn from_value(value: Value) -> Option<Self> {
                match value {
                    Value::$variant(inner) => Some(inner),
                    _ => None,
                }
            }
        }

        impl From<$rust> for Value {
            fn from(inner: $rust) -> Value {
                Value::$variant(inner)
            }
        }
    )*};
}

port_values! {
    String, Text;
    f64, Number;
    i64, Integer;
    bool, Bool;
    PlaceId, Place;
    RobotId, Robot;
    RoleId, Role;
    Pose, Pose;
    Seconds, Seconds;
    Vec<Value>, List;
}

impl PortValue for Value {
    const TYPE: PortType = PortType::Any;
    fn from_value(value: Value) -> Option<Value> {
        Some(value)
    }
}
