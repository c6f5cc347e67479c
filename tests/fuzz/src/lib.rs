//! The targets of `tests/untrusted/`, for cargo-fuzz.

#[path = "../../untrusted/targets/mod.rs"]
mod targets;

/// To be called before anything else: a panic that the program itself catches is none of the target's.
pub fn prepare() {
    let told = std::panic::take_hook();
    drop(told);
    std::panic::set_hook(Box::new(|problem| eprintln!("{problem}")));
}

/// Reads the bytes as the target of this name does.
///
/// # Panics
/// If what must hold does not, and if there is no such target.
pub fn hit(name: &str, bytes: &[u8]) {
    let target = targets::ALL.iter().find(|target| target.name == name).expect("a target of that name");
    (target.hit)(bytes);
}
