//! Trees as files: the XML of BehaviorTree.CPP 4, which Groot2 displays and edits.

mod model;
pub(super) mod read;
mod write;

pub use read::read_xml;
pub use write::write_xml;
