//! Ids within a virtual network.

/// Index of a node in the network.
pub(super) type NodeIndex = usize;

/// Id of a declaration or a query.
pub(super) type EntityId = u64;

/// A node between its start and its crash. Declarations and pending replies of an earlier
/// incarnation are void.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Incarnation {
    pub(super) index: NodeIndex,
    pub(super) number: u32,
}

/// Part of a single service in a single query.
#[derive(Debug, Clone, Copy)]
pub(super) struct QueryPart {
    pub(super) query: EntityId,
    pub(super) service: EntityId,
}
