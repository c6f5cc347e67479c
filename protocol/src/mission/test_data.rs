//! Domain and mission for unit tests.

use super::domain::Domain;

/// A mission file that uses every task type of [`domain`].
pub(crate) const FETCH_PARCEL: &str = include_str!("../../tests/data/fetch-parcel.yaml");

pub(crate) fn domain() -> Domain {
    serde_saphyr::from_str(include_str!("../../tests/data/domain.yaml")).expect("a domain")
}
