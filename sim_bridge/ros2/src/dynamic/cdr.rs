//! CDR of messages with a definition: OMG DDS-XTypes 1.3, 7.4.3, encoding version 1, little endian.

use super::types::{Base, Field, Primitive, Shape, TypeError, TypeRegistry};
use serde_json::{Map, Value};

/// Encapsulation header: CDR, little endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Greatest number of values of a received list.
const LIST_MAX: usize = 1 << 20;

/// A value does not fit a definition, or bytes cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The type is not defined.
    #[error(transparent)]
    Type(#[from] TypeError),
    /// A value has another type than its field.
    #[error("{path}: {value} is no {allowed}")]
    Value {
        /// Path of the field.
        path: String,
        /// The value.
        value: String,
        /// What the field allows.
        allowed: String,
    },
    /// A value has a field that the message does not have.
    #[error("{path}: {message} has no field {field:?}; allowed: {allowed}")]
    Field {
        /// Path of the message.
        path: String,
        /// The message.
        message: String,
        /// The field.
        field: String,
        /// Its fields.
        allowed: String,
    },
    /// The bytes are no message of the type.
    #[error("the bytes are no {0}")]
    Bytes(String),
}

/// Returns the bytes of a message. Fields that the value lacks have their default.
///
/// # Errors
/// [`CdrError`] with the path of a value that does not fit.
pub fn encode(types: &TypeRegistry, name: &str, value: &Value) -> Result<Vec<u8>, CdrError> {
    let mut writer = Writer { types, bytes: HEADER.to_vec() };
    writer.message(name, value, name)?;
    Ok(writer.bytes)
}

/// Reads a message.
///
/// # Errors
/// [`CdrError::Bytes`] if they are not a message of the type.
pub fn decode(types: &TypeRegistry, name: &str, bytes: &[u8]) -> Result<Value, CdrError> {
    let broken = || CdrError::Bytes(name.to_owned());
    let body = bytes.strip_prefix(&HEADER[..2]).and_then(|rest| rest.get(2..)).ok_or_else(broken)?;
    let mut reader = Reader { types, bytes: body, at: 0 };
    reader.message(name, 0)?.ok_or_else(broken)
}

struct Writer<'a> {
    types: &'a TypeRegistry,
    bytes: Vec<u8>,
}

impl Writer<'_> {
    fn align(&mut self, size: usize) {
        while !(self.bytes.len() - HEADER.len()).is_multiple_of(size) {
            self.bytes.push(0);
        }
    }

    fn put(&mut self, bytes: &[u8]) {
        self.align(bytes.len());
        self.bytes.extend(bytes);
    }

    fn length(&mut self, length: usize) {
        self.put(&u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
    }

    fn message(&mut self, name: &str, value: &Value, path: &str) -> Result<(), CdrError> {
        let fields = self.types.fields(name)?;
        let empty = Map::new();
        let given = match value {
            Value::Null => &empty,
            Value::Object(given) => given,
            other => return Err(wrong(path, other, name)),
        };
        if let Some(field) = given.keys().find(|key| !fields.iter().any(|field| field.name == **key)) {
            let allowed = fields.iter().map(|field| field.name.as_str()).collect::<Vec<_>>().join(", ");
            let (path, message) = (path.to_owned(), name.to_owned());
            return Err(CdrError::Field { path, message, field: field.clone(), allowed });
        }
        for field in fields {
            let value = given.get(&field.name).or(field.default.as_ref()).unwrap_or(&Value::Null);
            self.field(field, value, &format!("{path}.{}", field.name))?;
        }
        Ok(())
    }

    fn field(&mut self, field: &Field, value: &Value, path: &str) -> Result<(), CdrError> {
        let items: &[Value] = match (field.shape, value) {
            (Shape::Single, value) => return self.item(&field.base, value, path),
            (_, Value::Null) => &[],
            (_, Value::Array(items)) => items,
            (_, other) => return Err(wrong(path, other, "list")),
        };
        match field.shape {
            Shape::Sequence(most) => {
                if most.is_some_and(|most| items.len() > most) {
                    return Err(wrong(path, value, &format!("list of at most {} values", most.unwrap_or_default())));
                }
                self.length(items.len());
            }
            Shape::Array(length) if !items.is_empty() && items.len() != length => {
                return Err(wrong(path, value, &format!("list of {length} values")));
            }
            _ => {}
        }
        let missing = match field.shape {
            Shape::Array(length) => length - items.len(),
            _ => 0,
        };
        for item in items.iter().chain(std::iter::repeat_n(&Value::Null, missing)) {
            self.item(&field.base, item, path)?;
        }
        Ok(())
    }

    fn item(&mut self, base: &Base, value: &Value, path: &str) -> Result<(), CdrError> {
        match base {
            Base::Message(name) => self.message(name, value, path),
            Base::Primitive(Primitive::Bool, _) => {
                let value = match value {
                    Value::Null => false,
                    value => value.as_bool().ok_or_else(|| wrong(path, value, "boolean"))?,
                };
                self.put(&[u8::from(value)]);
                Ok(())
            }
            Base::Primitive(Primitive::Text, _) => {
                let text = match value {
                    Value::Null => "",
                    value => value.as_str().ok_or_else(|| wrong(path, value, "text"))?,
                };
                self.length(text.len() + 1);
                self.bytes.extend(text.as_bytes());
                self.bytes.push(0);
                Ok(())
            }
            Base::Primitive(Primitive::Int { bytes, signed }, _) => self.int(value, *bytes, *signed, path),
            Base::Primitive(Primitive::Float32, _) => {
                let number = float(value, path)? as f32;
                self.put(&number.to_le_bytes());
                Ok(())
            }
            Base::Primitive(Primitive::Float64, _) => {
                let number = float(value, path)?;
                self.put(&number.to_le_bytes());
                Ok(())
            }
        }
    }

    fn int(&mut self, value: &Value, bytes: u8, signed: bool, path: &str) -> Result<(), CdrError> {
        let bits = 8 * u32::from(bytes);
        let (least, most) = match signed {
            true => (-(1_i128 << (bits - 1)), (1_i128 << (bits - 1)) - 1),
            false => (0, (1_i128 << bits) - 1),
        };
        let whole = |number: &f64| number.fract() == 0.0 && number.abs() < 9e15;
        let number = match value {
            Value::Null => Some(0),
            value => (value.as_i64().map(i128::from))
                .or_else(|| value.as_u64().map(i128::from))
                .or_else(|| value.as_f64().filter(whole).map(|number| number as i128)),
        };
        let number = number.filter(|number| (least..=most).contains(number));
        let number = number.ok_or_else(|| wrong(path, value, &format!("whole number from {least} to {most}")))?;
        self.put(&number.to_le_bytes()[..usize::from(bytes)]);
        Ok(())
    }
}

fn float(value: &Value, path: &str) -> Result<f64, CdrError> {
    match value {
        Value::Null => Ok(0.0),
        // JSON cannot express them.
        Value::String(text) if text == "inf" => Ok(f64::INFINITY),
        Value::String(text) if text == "-inf" => Ok(f64::NEG_INFINITY),
        Value::String(text) if text == "nan" => Ok(f64::NAN),
        value => value.as_f64().ok_or_else(|| wrong(path, value, "number")),
    }
}

fn wrong(path: &str, value: &Value, allowed: &str) -> CdrError {
    CdrError::Value { path: path.to_owned(), value: value.to_string(), allowed: allowed.to_owned() }
}

struct Reader<'a> {
    types: &'a TypeRegistry,
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let from = self.at.next_multiple_of(N);
        let taken = self.bytes.get(from..from + N)?.try_into().ok()?;
        self.at = from + N;
        Some(taken)
    }

    fn length(&mut self) -> Option<usize> {
        let length = usize::try_from(u32::from_le_bytes(self.take()?)).ok()?;
        (length <= LIST_MAX && length <= self.bytes.len()).then_some(length)
    }

    /// Returns the message, or `None` if the bytes end before it.
    fn message(&mut self, name: &str, depth: usize) -> Result<Option<Value>, CdrError> {
        if depth > 16 {
            return Err(TypeError::Depth(name.to_owned()).into());
        }
        let mut read = Map::new();
        for field in self.types.fields(name)? {
            let Some(value) = self.field(field, depth)? else { return Ok(None) };
            read.insert(field.name.clone(), value);
        }
        Ok(Some(Value::Object(read)))
    }

    fn field(&mut self, field: &Field, depth: usize) -> Result<Option<Value>, CdrError> {
        let length = match field.shape {
            Shape::Single => return self.item(&field.base, depth),
            Shape::Array(length) => length,
            Shape::Sequence(_) => match self.length() {
                Some(length) => length,
                None => return Ok(None),
            },
        };
        let mut items = vec![];
        for _ in 0..length {
            let Some(item) = self.item(&field.base, depth)? else { return Ok(None) };
            items.push(item);
        }
        Ok(Some(Value::Array(items)))
    }

    fn item(&mut self, base: &Base, depth: usize) -> Result<Option<Value>, CdrError> {
        match base {
            Base::Message(name) => self.message(name, depth + 1),
            Base::Primitive(primitive, _) => Ok(self.primitive(*primitive)),
        }
    }

    fn primitive(&mut self, primitive: Primitive) -> Option<Value> {
        Some(match primitive {
            Primitive::Bool => Value::Bool(self.take::<1>()?[0] != 0),
            Primitive::Float32 => short_number(f32::from_le_bytes(self.take()?)),
            Primitive::Float64 => Value::from(f64::from_le_bytes(self.take()?)),
            Primitive::Int { bytes: 1, signed: true } => Value::from(i8::from_le_bytes(self.take()?)),
            Primitive::Int { bytes: 1, signed: false } => Value::from(u8::from_le_bytes(self.take()?)),
            Primitive::Int { bytes: 2, signed: true } => Value::from(i16::from_le_bytes(self.take()?)),
            Primitive::Int { bytes: 2, signed: false } => Value::from(u16::from_le_bytes(self.take()?)),
            Primitive::Int { bytes: 4, signed: true } => Value::from(i32::from_le_bytes(self.take()?)),
            Primitive::Int { bytes: 4, signed: false } => Value::from(u32::from_le_bytes(self.take()?)),
            Primitive::Int { signed: true, .. } => Value::from(i64::from_le_bytes(self.take()?)),
            Primitive::Int { signed: false, .. } => Value::from(u64::from_le_bytes(self.take()?)),
            Primitive::Text => {
                let length = self.length()?;
                let text = self.bytes.get(self.at..self.at + length)?;
                self.at += length;
                Value::from(String::from_utf8_lossy(text.strip_suffix(&[0]).unwrap_or(text)))
            }
        })
    }
}

/// Returns the shortest decimal number that is this `float32`: 0.9 and not 0.8999999761581421.
fn short_number(number: f32) -> Value {
    number.to_string().parse::<f64>().map_or(Value::Null, Value::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_message_is_read_as_it_was_written() {
        let mut types = TypeRegistry::shipped();
        types
            .define("a/msg/B", "bool on\nfloat64 x\nuint16[] list\nint64 big\nstring text\nfloat32[3] three\n")
            .unwrap();
        let value =
            json!({"on": true, "x": 0.5, "list": [1, 65535], "big": -5, "text": "wörter", "three": [1.0, 0.9, -2.0]});
        let bytes = encode(&types, "a/msg/B", &value).unwrap();
        assert_eq!(decode(&types, "a/msg/B", &bytes).unwrap(), value);
        let infinite = encode(&types, "std_msgs/msg/Float32", &json!({"data": "inf"})).unwrap();
        assert_eq!(infinite[4..], f32::INFINITY.to_le_bytes());
        assert_eq!(decode(&types, "std_msgs/msg/Float32", &infinite).unwrap(), json!({"data": null}));
        for length in 0..bytes.len() {
            assert!(decode(&types, "a/msg/B", &bytes[..length]).is_err(), "{length} bytes");
        }
    }

    /// The bytes of `tests/ros2/formats.rs`.
    #[test]
    fn a_pose_has_the_published_bytes() {
        let value = json!({"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"},
            "pose": {"position": {"x": 1.0, "y": 2.0}}});
        let bytes = encode(&TypeRegistry::shipped(), "geometry_msgs/msg/PoseStamped", &value).unwrap();
        assert_eq!(&bytes[..12], &[0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
        assert_eq!(&bytes[12..20], &[4, 0, 0, 0, b'm', b'a', b'p', 0]);
        assert_eq!(bytes.len(), 4 + 16 + 56, "seven numbers at multiples of eight");
        assert_eq!(&bytes[bytes.len() - 8..], &1.0_f64.to_le_bytes(), "the default rotation");
    }

    #[test]
    fn wrong_values_are_named_by_their_path() {
        let types = TypeRegistry::shipped();
        let error = |value: Value| encode(&types, "nav2_msgs/action/Spin_Goal", &value).unwrap_err().to_string();
        assert_eq!(
            error(json!({"target_yaw": "left"})),
            "nav2_msgs/action/Spin_Goal.target_yaw: \"left\" is no number"
        );
        assert!(error(json!({"yaw": 1})).ends_with("has no field \"yaw\"; allowed: target_yaw, time_allowance"));
        assert!(error(json!({"time_allowance": {"sec": 0.5}})).contains("whole number from -2147483648"));
    }
}
