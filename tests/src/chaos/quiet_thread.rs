//! Threads of runs.

use std::panic;
use std::sync::Once;
use std::thread;

/// Name of the threads that run fleets.
const THREAD: &str = "chaos";

/// Returns the builder of a thread that prints no panics. Injected skill panics are expected, and a panic of a run is
/// reported as its result.
pub(super) fn quiet_thread() -> thread::Builder {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let default_hook = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if thread::current().name() != Some(THREAD) {
                default_hook(info);
            }
        }));
    });
    thread::Builder::new().name(THREAD.to_owned())
}
