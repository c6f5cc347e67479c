//! Names of what only the world knows.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

macro_rules! names {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        /// Checked where the world is set up: 1 to 64 characters, none of them a control character.
        #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
        #[serde(transparent)]
        pub struct $name(pub String);

        impl $name {
            /// The name as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }

            pub(super) fn is_sound(&self) -> bool {
                let length = self.0.chars().count();
                (1..=consort_protocol::ids::MAX_CHARS).contains(&length) && !self.0.contains(char::is_control)
            }
        }

        impl From<&str> for $name {
            fn from(text: &str) -> Self {
                Self(text.to_owned())
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }
    )*};
}

names! {
    /// A person, as colleagues call them.
    PersonName;
    /// A sample, as its label says.
    SampleId;
}
