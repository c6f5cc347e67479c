//! Identity of systems, and the components that a system may access.

use hecs::{Component, Entity};
use std::any::TypeId;

/// Index of a system in a world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SystemIndex(pub(super) usize);

/// Type of a component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ComponentType {
    id: TypeId,
    name: &'static str,
}

impl ComponentType {
    /// Returns the component type of `T`.
    pub fn of<T: Component>() -> ComponentType {
        ComponentType { id: TypeId::of::<T>(), name: std::any::type_name::<T>() }
    }

    /// Checks whether this is the type with the given id.
    pub(crate) fn is(self, id: TypeId) -> bool {
        self.id == id
    }

    /// Name of the type, without its path.
    pub(crate) fn name(self) -> &'static str {
        self.name.rsplit("::").next().unwrap_or(self.name)
    }
}

/// Expands to a list of [`ComponentType`]s.
#[macro_export]
macro_rules! component_types {
    ($($component:ty),* $(,)?) => { vec![$($crate::world::ComponentType::of::<$component>()),*] };
}

/// A timer that a system scheduled for itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SystemTimer {
    /// The entity concerned.
    pub entity: Entity,
    /// Number by which the system distinguishes its timers.
    pub number: u64,
}

/// The system that is running: its index in this world, and the components it may access.
pub(super) struct RunningSystem {
    pub(super) index: SystemIndex,
    pub(super) name: &'static str,
    pub(super) reads: Vec<ComponentType>,
    pub(super) writes: Vec<ComponentType>,
}

impl RunningSystem {
    /// Panics if the system accesses a component that it does not declare.
    pub(super) fn check(&self, kind: ComponentType, writes: bool) {
        let allowed = self.writes.contains(&kind) || !writes && self.reads.contains(&kind);
        let does = if writes { "writes" } else { "reads" };
        assert!(allowed, "system {} {does} {}, which it does not declare", self.name, kind.name());
    }

    /// The same as [`check`](Self::check) where only the type's id is known.
    pub(super) fn check_id(&self, id: TypeId, writes: bool) {
        let named = |component_types: &[ComponentType]| component_types.iter().any(|kind| kind.is(id));
        let does = if writes { "writes" } else { "reads" };
        let allowed = named(&self.writes) || !writes && named(&self.reads);
        assert!(allowed, "system {} {does} a component of its query without declaring it", self.name);
    }
}
