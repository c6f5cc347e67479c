//! Author of a received message.

use consort_protocol::trust::Identity;
use std::sync::Arc;

/// Author of a received message. In a closed fleet the bus delivers only messages with a verified
/// author. In an open fleet authors are unknown, and every program on the bus is trusted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Author(Option<Arc<Identity>>);

impl Author {
    /// Unknown author: a message in an open fleet.
    pub const UNKNOWN: Author = Author(None);

    /// Creates the author of a message with a valid signature.
    pub fn verified(identity: Arc<Identity>) -> Author {
        Author(Some(identity))
    }

    /// Returns the name of a verified author.
    pub fn name(&self) -> Option<String> {
        self.0.as_ref().map(|author| author.principal.name().to_string())
    }

    /// Checks whether the message may be by this node.
    pub fn may_be(&self, node: &str) -> bool {
        self.0.as_ref().is_none_or(|author| author.is_node(node))
    }

    /// Checks whether the author may be a driver server of this robot, or of the people with this
    /// role.
    pub fn may_serve(&self, served: &str) -> bool {
        self.0.as_ref().is_none_or(|author| author.serves(served))
    }
}

impl std::fmt::Display for Author {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.0 {
            Some(author) => write!(f, "{}", author.principal),
            None => f.write_str("unknown author"),
        }
    }
}
