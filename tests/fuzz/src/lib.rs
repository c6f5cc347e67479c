//! The targets of `tests/fuzz_targets/` for cargo-fuzz.

#[path = "../../fuzz_targets/targets/mod.rs"]
mod targets;

/// Installs a panic hook that does not abort. Must be called first: a panic that the program itself
/// catches is no failure of the target.
pub fn prepare() {
    drop(std::panic::take_hook());
    std::panic::set_hook(Box::new(|problem| eprintln!("{problem}")));
}

/// Reads the bytes with the target of this name.
///
/// # Panics
/// If a required property is violated, or if there is no such target.
pub fn hit(name: &str, bytes: &[u8]) {
    let target = targets::ALL.iter().find(|target| target.name == name).expect("a target of that name");
    (target.run)(bytes);
}
