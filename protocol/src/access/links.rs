//! Access control of links by the certificate of the neighbour: the rules that every node gives to
//! Zenoh.
//!
//! Zenoh identifies a neighbour by the common name of its certificate only, so that name is the
//! *kind* of principal ([`common_name`]). So the rules also hold for principals that do not exist
//! yet, and no node needs a list of all others. Nodes relay for each other, so the link of a node
//! carries all traffic of the fleet's tree and nothing outside it. Envelopes ensure that each node
//! publishes only in its own name. The link of a person carries views, requests within the scope,
//! and subscriptions.

use crate::ids::FleetId;
use crate::keys::{ApiCall, Key, Keys};
use crate::trust::{AccessScope, Identity, Principal};

/// Type of a message on a link, as distinguished by Zenoh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LinkMessage {
    /// Publication.
    Put,
    /// Deletion of a key.
    Delete,
    /// Declaration of a subscriber.
    DeclareSubscriber,
    /// Query.
    Query,
    /// Declaration of a queryable.
    DeclareQueryable,
    /// Reply.
    Reply,
    /// Presence token.
    LivelinessToken,
    /// Declaration of a subscriber for presence tokens.
    DeclareLivelinessSubscriber,
    /// Query for presence tokens.
    LivelinessQuery,
}

impl LinkMessage {
    /// All types.
    pub const ALL: [LinkMessage; 9] = [
        LinkMessage::Put,
        LinkMessage::Delete,
        LinkMessage::DeclareSubscriber,
        LinkMessage::Query,
        LinkMessage::DeclareQueryable,
        LinkMessage::Reply,
        LinkMessage::LivelinessToken,
        LinkMessage::DeclareLivelinessSubscriber,
        LinkMessage::LivelinessQuery,
    ];

    /// Returns Zenoh's name of the type.
    pub fn as_str(self) -> &'static str {
        match self {
            LinkMessage::Put => "put",
            LinkMessage::Delete => "delete",
            LinkMessage::DeclareSubscriber => "declare_subscriber",
            LinkMessage::Query => "query",
            LinkMessage::DeclareQueryable => "declare_queryable",
            LinkMessage::Reply => "reply",
            LinkMessage::LivelinessToken => "liveliness_token",
            LinkMessage::DeclareLivelinessSubscriber => "declare_liveliness_subscriber",
            LinkMessage::LivelinessQuery => "liveliness_query",
        }
    }
}

/// Messages that links to principals with a common name accept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// Common name.
    pub common_name: String,
    /// Accepted message types and their key expressions. All other messages are rejected.
    pub permits: Vec<(Vec<LinkMessage>, Vec<String>)>,
}

/// Returns the common name in a principal's certificate.
pub fn common_name(identity: &Identity) -> String {
    match &identity.principal {
        Principal::Node { .. } => "consort-node".to_owned(),
        Principal::Person { scope, .. } => person(*scope),
    }
}

fn person(scope: AccessScope) -> String {
    format!("consort-{scope}")
}

/// Returns the messages that the links of a fleet's node accept. `extra` are key expressions
/// outside the fleet's tree that neighbours use.
pub fn grants(fleet: &FleetId, extra: &[&str]) -> Vec<Grant> {
    let keys = Keys::new(fleet);
    let mut all = vec![format!("consort/{fleet}/**")];
    all.extend(extra.iter().map(|extra| (*extra).to_owned()));
    let node = Grant { common_name: "consort-node".to_owned(), permits: vec![(LinkMessage::ALL.to_vec(), all)] };
    let persons = AccessScope::ALL.iter().map(|scope| Grant {
        common_name: person(*scope),
        permits: vec![
            (vec![LinkMessage::Query], queries(&keys, *scope)),
            (vec![LinkMessage::DeclareSubscriber], subscriptions(&keys)),
            (vec![LinkMessage::DeclareLivelinessSubscriber, LinkMessage::LivelinessQuery], vec![keys.any_alive()]),
        ],
    });
    std::iter::once(node).chain(persons).collect()
}

/// Returns the keys that a person with this scope may query.
fn queries(keys: &Keys, scope: AccessScope) -> Vec<String> {
    let calls = ApiCall::ALL.iter().filter(|call| required_scope(**call) <= scope);
    let mut queries: Vec<String> = calls.map(|call| keys.write(&Key::Api(*call))).collect();
    queries.extend([keys.any_view(), keys.any_seen_by_any(), keys.any_help(), keys.any_certificate()]);
    if scope >= AccessScope::Operate {
        queries.push(keys.any_leave());
    }
    queries
}

/// Returns the keys that any person may subscribe to: events, and the data from which a fleet is
/// drawn.
fn subscriptions(keys: &Keys) -> Vec<String> {
    vec![keys.any_events(), keys.any_driver_state(), keys.write(&Key::Beacon)]
}

/// Returns the scope that a call requires.
pub fn required_scope(call: ApiCall) -> AccessScope {
    match call {
        _ if call.is_read_only() => AccessScope::Read,
        ApiCall::Submit
        | ApiCall::Cancel
        | ApiCall::CancelMissions
        | ApiCall::Priority
        | ApiCall::Reassign
        | ApiCall::Answer
        | ApiCall::Schedule
        | ApiCall::Hold
        | ApiCall::Release
        | ApiCall::Maintenance
        | ApiCall::Close
        | ApiCall::Open
        | ApiCall::Limit
        | ApiCall::Alarm => AccessScope::Submit,
        // Also any call that is added without a decision about its scope.
        _ => AccessScope::Operate,
    }
}

/// Returns the scope of the person that must sign a query on a key (below the fleet's prefix), or
/// `None` if the query changes nothing.
pub fn scope_to_sign(key: &str) -> Option<AccessScope> {
    let segments: Vec<&str> = key.split('/').collect();
    match segments.as_slice() {
        ["api", "leave", _] => Some(AccessScope::Operate),
        ["api", call] => ApiCall::parse(call).filter(|call| !call.is_read_only()).map(required_scope),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_that_change_the_fleet_are_signed() {
        let scopes = ["api/submit", "api/resolve", "api/leave/ada", "api/get", "api/submit/help", "view/fleet"];
        let needed = [AccessScope::Submit, AccessScope::Operate, AccessScope::Operate].map(Some);
        assert_eq!(scopes.map(scope_to_sign)[..3], needed);
        assert_eq!(scopes.map(scope_to_sign)[3..], [None; 3]);
    }

    fn ward() -> FleetId {
        FleetId::new("ward").unwrap()
    }

    fn may(scope: AccessScope, passing: LinkMessage, key: &str) -> bool {
        let grants = grants(&ward(), &[]);
        let grant = grants.iter().find(|grant| grant.common_name == person(scope)).unwrap();
        let mut matching = grant.permits.iter().filter(|(passings, _)| passings.contains(&passing));
        matching.any(|(_, keys)| keys.iter().any(|granted| granted == key))
    }

    #[test]
    fn a_person_queries_within_the_scope_and_publishes_nothing() {
        use LinkMessage::{DeclareSubscriber, Put, Query, Reply};
        for (scope, submits, operates) in
            [(AccessScope::Read, false, false), (AccessScope::Submit, true, false), (AccessScope::Operate, true, true)]
        {
            assert!(may(scope, Query, "consort/ward/view/**"));
            assert_eq!(may(scope, Query, "consort/ward/api/submit"), submits);
            assert_eq!(may(scope, Query, "consort/ward/api/resolve"), operates);
            assert_eq!(may(scope, Query, "consort/ward/api/leave/*"), operates);
            assert!(may(scope, DeclareSubscriber, "consort/ward/events/**"));
            let grants = grants(&ward(), &[]);
            let own = grants.iter().find(|grant| grant.common_name == person(scope)).unwrap();
            let publishes =
                own.permits.iter().flat_map(|(passings, _)| passings).any(|passing| [Put, Reply].contains(passing));
            assert!(!publishes, "{scope}");
        }
    }

    #[test]
    fn the_common_name_is_the_kind_of_principal() {
        let named = |of: &str| common_name(&format!("consort://ward/{of}").parse().unwrap());
        assert_eq!(named("node/ada?roles=robot,voter"), "consort-node");
        assert_eq!(named("person/ada?scope=read"), "consort-read");
        assert_eq!(named("person/ada?scope=operate"), "consort-operate");
        let granted: Vec<String> = grants(&ward(), &[]).into_iter().map(|grant| grant.common_name).collect();
        assert_eq!(granted, ["consort-node", "consort-read", "consort-submit", "consort-operate"]);
    }

    #[test]
    fn a_nodes_link_carries_its_fleet_and_no_other() {
        let grants = grants(&ward(), &["consort-link-check/*"]);
        assert_eq!(
            grants[0].permits,
            [(LinkMessage::ALL.to_vec(), vec!["consort/ward/**".to_owned(), "consort-link-check/*".to_owned()])]
        );
    }
}
