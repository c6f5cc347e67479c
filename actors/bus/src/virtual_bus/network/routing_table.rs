//! Matching of declarations to keys, cached per key.

use crate::virtual_bus::ids::{EntityId, NodeIndex};
use crate::virtual_bus::link::MessageClass;
use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use zenoh_keyexpr::OwnedKeyExpr;
use zenoh_keyexpr::keyexpr_tree::{IKeyExprTree as _, IKeyExprTreeMut as _, IKeyExprTreeNode as _, KeBoxTree};

/// Maximum number of cached keys. Beyond this the whole cache is cleared.
const ROUTES_MAX: usize = 65_536;

/// A subscription or a service: its node and its key expression.
pub(super) struct Declaration<M> {
    pub(super) node: NodeIndex,
    pub(super) key_expr: OwnedKeyExpr,
    /// Set for a complete service, which has every value below its key. Services only.
    pub(super) complete: bool,
    pub(super) mailbox: M,
}

/// Declarations of a single kind, and cached matches for recently used keys.
pub(super) struct RoutingTable<M> {
    pub(super) declared: BTreeMap<EntityId, Declaration<M>>,
    /// Ids of the declarations by key expression.
    by_key: KeBoxTree<Vec<EntityId>>,
    routes: HashMap<String, Arc<Route>>,
    /// Keys of the cached routes.
    cached: KeBoxTree<()>,
    /// Incremented when a declaration is added or removed: a route with the same version is still
    /// valid.
    pub(super) version: u64,
}

/// The declarations that match a key.
pub(super) struct Route {
    pub(super) key: OwnedKeyExpr,
    /// Hash of the key. Two keys with the same hash would merely be ordered together.
    pub(super) hash: u64,
    pub(super) class: MessageClass,
    /// Receivers by node index, in order.
    pub(super) targets: Vec<(NodeIndex, Vec<EntityId>)>,
    /// Services that are complete for the key, in the order of their node indexes.
    pub(super) complete: Vec<(NodeIndex, EntityId)>,
}

impl<M> RoutingTable<M> {
    pub(super) fn new() -> Self {
        RoutingTable {
            declared: BTreeMap::new(),
            by_key: KeBoxTree::new(),
            routes: HashMap::new(),
            cached: KeBoxTree::new(),
            version: 0,
        }
    }

    pub(super) fn declare(&mut self, id: EntityId, declaration: Declaration<M>) {
        self.invalidate(&declaration.key_expr);
        match self.by_key.weight_at_mut(&declaration.key_expr) {
            Some(ids) => ids.push(id),
            None => drop(self.by_key.insert(&declaration.key_expr, vec![id])),
        }
        self.declared.insert(id, declaration);
    }

    pub(super) fn remove(&mut self, id: EntityId) {
        if let Some(removed) = self.declared.remove(&id) {
            self.forget(id, &removed.key_expr);
            self.invalidate(&removed.key_expr);
        }
    }

    pub(super) fn remove_node(&mut self, index: NodeIndex) {
        let of_node = self.declared.iter().filter(|(_, declaration)| declaration.node == index);
        for id in of_node.map(|(id, _)| *id).collect::<Vec<_>>() {
            if let Some(removed) = self.declared.remove(&id) {
                self.forget(id, &removed.key_expr);
            }
        }
        self.version += 1;
        self.clear_routes();
    }

    fn forget(&mut self, id: EntityId, key_expr: &OwnedKeyExpr) {
        let Some(ids) = self.by_key.weight_at_mut(key_expr) else { return };
        ids.retain(|declared| *declared != id);
        if ids.is_empty() {
            self.by_key.remove(key_expr);
        }
    }

    fn invalidate(&mut self, key_expr: &OwnedKeyExpr) {
        self.version += 1;
        let outdated = self.cached.intersecting_nodes(key_expr).filter(|node| node.weight().is_some());
        let outdated: Vec<OwnedKeyExpr> = outdated.map(|node| node.keyexpr()).collect();
        for key in outdated {
            self.cached.remove(&key);
            self.routes.remove(key.as_str());
        }
    }

    fn clear_routes(&mut self) {
        self.routes.clear();
        self.cached = KeBoxTree::new();
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
        let mut matching: Vec<EntityId> =
            self.by_key.intersecting_nodes(key).filter_map(|node| node.weight()).flatten().copied().collect();
        matching.sort_unstable();
        for id in matching {
            let declaration = &self.declared[&id];
            targets.entry(declaration.node).or_default().push(id);
            if declaration.complete && declaration.key_expr.includes(key) {
                complete.push((declaration.node, id));
            }
        }
        complete.sort_unstable();
        let mut hasher = DefaultHasher::new();
        key.as_str().hash(&mut hasher);
        let route = Arc::new(Route {
            key: key.clone(),
            hash: hasher.finish(),
            class: MessageClass::of(key),
            targets: targets.into_iter().collect(),
            complete,
        });
        if self.routes.len() >= ROUTES_MAX {
            self.clear_routes();
        }
        self.cached.insert(key, ());
        self.routes.insert(key.to_string(), Arc::clone(&route));
        route
    }
}
