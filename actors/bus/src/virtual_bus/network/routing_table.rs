//! Matching of declarations to keys, cached per key.

use crate::virtual_bus::ids::{EntityId, NodeIndex};
use consort_protocol::keys::KeyKind;
use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use tokio::sync::mpsc::UnboundedSender;
use zenoh_keyexpr::OwnedKeyExpr;

/// Maximum number of cached keys. Beyond this the whole cache is cleared.
const ROUTES_MAX: usize = 65_536;

/// A subscription or a service: its node and its key expression.
pub(super) struct Declaration<T> {
    pub(super) node: NodeIndex,
    pub(super) key_expr: OwnedKeyExpr,
    /// Set for a complete service, which has every value below its key. Services only.
    pub(super) complete: bool,
    pub(super) mailbox: UnboundedSender<T>,
}

/// Declarations of a single kind, and cached matches for recently used keys.
pub(super) struct RoutingTable<T> {
    pub(super) declared: BTreeMap<EntityId, Declaration<T>>,
    routes: HashMap<String, Arc<Route>>,
    /// Incremented when a declaration is added or removed: a route with the same version is still
    /// valid.
    pub(super) version: u64,
}

/// The declarations that match a key.
pub(super) struct Route {
    pub(super) key: OwnedKeyExpr,
    /// Hash of the key. Two keys with the same hash would merely be ordered together.
    pub(super) hash: u64,
    pub(super) kind: KeyKind,
    /// Receivers by node index, in order.
    pub(super) targets: Vec<(NodeIndex, Vec<EntityId>)>,
    /// Services that are complete for the key, in the order of their node indexes.
    pub(super) complete: Vec<(NodeIndex, EntityId)>,
}

impl<T> RoutingTable<T> {
    pub(super) fn new() -> Self {
        RoutingTable { declared: BTreeMap::new(), routes: HashMap::new(), version: 0 }
    }

    pub(super) fn declare(&mut self, id: EntityId, declaration: Declaration<T>) {
        self.invalidate(&declaration.key_expr);
        self.declared.insert(id, declaration);
    }

    pub(super) fn remove(&mut self, id: EntityId) {
        if let Some(removed) = self.declared.remove(&id) {
            self.invalidate(&removed.key_expr);
        }
    }

    pub(super) fn remove_node(&mut self, index: NodeIndex) {
        self.declared.retain(|_, declaration| declaration.node != index);
        self.version += 1;
        self.routes.clear();
    }

    fn invalidate(&mut self, key_expr: &OwnedKeyExpr) {
        self.version += 1;
        self.routes.retain(|_, route| !route.key.intersects(key_expr));
    }

    pub(super) fn cached_route(&self, key: &str) -> Option<Arc<Route>> {
        self.routes.get(key).cloned()
    }

    pub(super) fn route(&mut self, key: &OwnedKeyExpr) -> Arc<Route> {
        if let Some(route) = self.routes.get(key.as_str()) {
            return Arc::clone(route);
        }
        let mut targets: BTreeMap<NodeIndex, Vec<EntityId>> = BTreeMap::new();
        let mut complete = Vec::new();
        for (id, declaration) in &self.declared {
            if declaration.key_expr.intersects(key) {
                targets.entry(declaration.node).or_default().push(*id);
                if declaration.complete && declaration.key_expr.includes(key) {
                    complete.push((declaration.node, *id));
                }
            }
        }
        complete.sort_unstable();
        let mut hasher = DefaultHasher::new();
        key.as_str().hash(&mut hasher);
        let route = Arc::new(Route {
            key: key.clone(),
            hash: hasher.finish(),
            kind: KeyKind::of(key),
            targets: targets.into_iter().collect(),
            complete,
        });
        if self.routes.len() >= ROUTES_MAX {
            self.routes.clear();
        }
        self.routes.insert(key.to_string(), Arc::clone(&route));
        route
    }
}
