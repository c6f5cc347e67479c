//! A watcher of presence tokens.

use crate::bus::Presence;
use crate::mailbox::MailboxSender;
use std::collections::BTreeMap;
use zenoh_keyexpr::OwnedKeyExpr;

/// A watcher of presence tokens.
pub(super) struct PresenceWatch {
    pub(super) key_expr: OwnedKeyExpr,
    pub(super) mailbox: MailboxSender<Presence>,
    /// Number of known tokens per key.
    pub(super) present: BTreeMap<String, u32>,
}

impl PresenceWatch {
    /// Updates the number of known tokens on a key, and notifies the watcher of a change.
    pub(super) fn update(&mut self, key: &OwnedKeyExpr, alive: bool) {
        if !self.key_expr.intersects(key) {
            return;
        }
        let count = self.present.entry(key.to_string()).or_insert(0);
        let before = *count;
        *count = if alive { before + 1 } else { before.saturating_sub(1) };
        let after = *count;
        if after == 0 {
            self.present.remove(key.as_str());
        }
        if (before == 0) != (after == 0) {
            // The watcher may be gone: ignore the error.
            self.mailbox.send(Presence { key: key.to_string(), alive });
        }
    }
}
