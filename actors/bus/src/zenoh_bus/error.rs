//! Conversion of Zenoh's errors.

use super::settings::ZenohSettings;
use crate::bus::BusError;

/// Returns the error of a failed operation.
pub(super) fn failed(what: impl Into<String>, problem: impl ToString) -> BusError {
    BusError::Failed { operation: what.into(), problem: problem.to_string() }
}

/// Converts an error of opening a session. Zenoh's errors name source lines; operators need the
/// address instead.
pub(super) fn open_error(settings: &ZenohSettings, problem: &str) -> BusError {
    let problem = problem.split(" at /").next().unwrap_or_default().trim_end();
    let of = |addresses: &[String]| addresses.iter().find(|address| problem.contains(address.as_str())).cloned();
    if settings.mode.is_client() {
        return failed(format!("reach a router at {}", settings.connect.join(", ")), problem);
    }
    match of(&settings.listen) {
        Some(address) if problem.contains("in use") => {
            failed(format!("listen on {address}"), format!("the port is taken ({problem})"))
        }
        Some(address) => failed(format!("listen on {address}"), problem),
        None => failed("open", problem),
    }
}
