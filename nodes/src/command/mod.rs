//! The commands, one a file: each has its flags, and `run`.

pub mod bench;
pub mod cancel;
pub mod cert;
pub mod chaos;
pub mod check;
mod drawn_world;
pub mod dry_run;
pub mod experiment;
pub mod explain;
pub mod flags;
pub mod fleet;
pub mod keys;
pub mod leave;
pub mod map;
pub mod missions;
mod on_word;
pub mod record;
pub mod recover;
pub mod replay;
pub mod rescue;
pub mod robot;
pub mod station;
pub mod submit;
pub mod test;
pub mod watch;
pub mod world;
