//! Values of flags with names.

use consort_nodes::command::flag_values::InvalidValue;

/// Finds the value with a name.
pub(super) fn named<T: Copy>(text: &str, all: &[T], name: impl Fn(T) -> &'static str) -> Result<T, InvalidValue> {
    let known = || all.iter().map(|one| name(*one)).collect::<Vec<_>>().join(", ");
    all.iter()
        .copied()
        .find(|one| name(*one) == text)
        .ok_or_else(|| InvalidValue::new(format_args!("there are: {}", known())))
}
