//! Which declarations match a key, found once for each key.

use super::{EntityId, NodeIndex};
use consort_protocol::keys::KeyKind;
use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use tokio::sync::mpsc::UnboundedSender;
use zenoh_keyexpr::OwnedKeyExpr;

/// Keys whose receivers are remembered; beyond this all are forgotten and found anew.
const ROUTES_MAX: usize = 65_536;

/// A subscription or a service: where it is and what it wants.
pub(super) struct Declaration<T> {
    pub(super) node: NodeIndex,
    pub(super) key_expr: OwnedKeyExpr,
    /// Whether it knows all there is below its key: of services alone.
    pub(super) complete: bool,
    pub(super) mailbox: UnboundedSender<T>,
}

/// Declarations of one kind, and which of them match keys used lately.
pub(super) struct RoutingTable<T> {
    pub(super) declared: BTreeMap<EntityId, Declaration<T>>,
    routes: HashMap<String, Arc<Route>>,
    /// Grows whenever a declaration comes or goes: a route found under the same number is still right.
    pub(super) version: u64,
}

/// The declarations that match a key.
pub(super) struct Route {
    pub(super) key: OwnedKeyExpr,
    /// Stands for the key where a number is handier. Two keys with one hash would merely be ordered together.
    pub(super) hash: u64,
    pub(super) kind: KeyKind,
    /// By place, in order.
    pub(super) targets: Vec<(NodeIndex, Vec<EntityId>)>,
    /// Those that know all that is asked for, in the order of their places.
    pub(super) complete: Vec<(NodeIndex, EntityId)>,
}

impl<T> RoutingTable<T> {
    pub(super) fn new() -> Self {
        RoutingTable { declared: BTreeMap::new(), routes: HashMap::new(), version: 0 }
    }

    pub(super) fn declare(&mut self, number: EntityId, declaration: Declaration<T>) {
        self.changed(&declaration.key_expr);
        self.declared.insert(number, declaration);
    }

    pub(super) fn remove(&mut self, number: EntityId) {
        if let Some(gone) = self.declared.remove(&number) {
            self.changed(&gone.key_expr);
        }
    }

    pub(super) fn remove_node(&mut self, place: NodeIndex) {
        self.declared.retain(|_, declaration| declaration.node != place);
        self.version += 1;
        self.routes.clear();
    }

    fn changed(&mut self, wanted: &OwnedKeyExpr) {
        self.version += 1;
        self.routes.retain(|_, route| !route.key.intersects(wanted));
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
        for (number, declaration) in &self.declared {
            if declaration.key_expr.intersects(key) {
                targets.entry(declaration.node).or_default().push(*number);
                if declaration.complete && declaration.key_expr.includes(key) {
                    complete.push((declaration.node, *number));
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
