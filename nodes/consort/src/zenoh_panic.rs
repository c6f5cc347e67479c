//! End of the process after a panic in Zenoh.
//!
//! Zenoh 1.10 can panic in the routing of a node when a link is lost, while it holds the lock of its
//! tables (`consort-lab soak` found it; eclipse-zenoh/zenoh issue 2624 is about a related place); builds
//! with debug assertions panic more often. Its runtime catches the panic, and the node continues with a
//! poisoned lock: every later task that uses the tables panics, too. A node that has ended is better: the
//! others notice it at once, and its service manager starts it again.

use std::panic::{self, PanicHookInfo};
use std::path::Path;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};

/// True once the node has left the fleet: it needs Zenoh no longer.
static HAS_LEFT: AtomicBool = AtomicBool::new(false);

/// Lets this process end as usual after a panic in Zenoh from now on. Zenoh can panic in its threads while the
/// session closes.
pub(crate) fn accept_zenoh_panics() {
    HAS_LEFT.store(true, Ordering::Relaxed);
}

/// Ends this process with SIGABRT after a panic in the code of Zenoh, until the node
/// [has left](accept_zenoh_panics). Other panics are reported as before.
pub(crate) fn abort_on_zenoh_panic() {
    let report = panic::take_hook();
    panic::set_hook(Box::new(move |info: &PanicHookInfo<'_>| {
        report(info);
        let is_in_zenoh = info.location().is_some_and(|location| is_in_zenoh(Path::new(location.file())));
        if is_in_zenoh && !HAS_LEFT.load(Ordering::Relaxed) {
            process::abort();
        }
    }));
}

/// Checks whether a source file belongs to a crate of Zenoh, whose folders are named like
/// `zenoh-transport-1.10.2`.
fn is_in_zenoh(file: &Path) -> bool {
    file.components().any(|part| part.as_os_str().to_string_lossy().starts_with("zenoh-"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_panics_in_zenoh_end_the_process() {
        let is_in_zenoh = |file: &str| is_in_zenoh(Path::new(file));
        assert!(is_in_zenoh("/registry/src/index/zenoh-1.10.2/src/net/routing/dispatcher/resource.rs"));
        assert!(is_in_zenoh("/registry/src/index/zenoh-transport-1.10.2/src/manager.rs"));
        assert!(!is_in_zenoh("actors/bus/src/zenoh_bus/mod.rs"));
        assert!(!is_in_zenoh("actors/fleet/src/robot/actor.rs"));
    }
}
