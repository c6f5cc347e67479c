//! Which declarations match a key, found once for each key.

use super::{Number, Place};
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
    pub(super) place: Place,
    pub(super) wanted: OwnedKeyExpr,
    /// Whether it knows all there is below its key: of services alone.
    pub(super) complete: bool,
    pub(super) mailbox: UnboundedSender<T>,
}

/// Declarations of one kind, and which of them match keys used lately.
pub(super) struct Directory<T> {
    pub(super) declared: BTreeMap<Number, Declaration<T>>,
    routes: HashMap<String, Arc<Route>>,
    /// Grows whenever a declaration comes or goes: a route found under the same number is still right.
    pub(super) edition: u64,
}

/// The declarations that match a key.
pub(super) struct Route {
    pub(super) key: OwnedKeyExpr,
    /// Stands for the key where a number is handier. Two keys with one hash would merely be ordered together.
    pub(super) hash: u64,
    pub(super) kind: KeyKind,
    /// By place, in order.
    pub(super) targets: Vec<(Place, Vec<Number>)>,
    /// Those that know all that is asked for, in the order of their places.
    pub(super) complete: Vec<(Place, Number)>,
}

impl<T> Directory<T> {
    pub(super) fn new() -> Self {
        Directory { declared: BTreeMap::new(), routes: HashMap::new(), edition: 0 }
    }

    pub(super) fn declare(&mut self, number: Number, declaration: Declaration<T>) {
        self.changed(&declaration.wanted);
        self.declared.insert(number, declaration);
    }

    pub(super) fn withdraw(&mut self, number: Number) {
        if let Some(gone) = self.declared.remove(&number) {
            self.changed(&gone.wanted);
        }
    }

    pub(super) fn withdraw_all(&mut self, place: Place) {
        self.declared.retain(|_, declaration| declaration.place != place);
        self.edition += 1;
        self.routes.clear();
    }

    fn changed(&mut self, wanted: &OwnedKeyExpr) {
        self.edition += 1;
        self.routes.retain(|_, route| !route.key.intersects(wanted));
    }

    pub(super) fn known_route(&self, key: &str) -> Option<Arc<Route>> {
        self.routes.get(key).cloned()
    }

    pub(super) fn route(&mut self, key: &OwnedKeyExpr) -> Arc<Route> {
        if let Some(route) = self.routes.get(key.as_str()) {
            return Arc::clone(route);
        }
        let mut targets: BTreeMap<Place, Vec<Number>> = BTreeMap::new();
        let mut complete = Vec::new();
        for (number, declaration) in &self.declared {
            if declaration.wanted.intersects(key) {
                targets.entry(declaration.place).or_default().push(*number);
                if declaration.complete && declaration.wanted.includes(key) {
                    complete.push((declaration.place, *number));
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
