//! What a link lets through, by the certificate at its other end: the rules that every node gives to Zenoh.
//!
//! Zenoh knows a neighbour by the common name of its certificate and nothing else of it, so that name is the *kind* of
//! bearer ([`common_name`]): rules then hold for bearers that do not exist yet, and no node needs a list of all others. Nodes
//! relay for each other, so a node's link carries whatever the fleet says, and nothing outside the fleet's tree; that each
//! speaks in its own name alone is what seals are for. A person's link carries views, requests within the
//! scope, and what is to be heard.

use super::identity::{AccessScope, Identity, Principal};
use crate::ids::FleetId;
use crate::keys::{ApiCall, Key, Keys};

/// What a message on a link is, as Zenoh tells them apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LinkMessage {
    /// Something published.
    Put,
    /// A key struck out.
    Delete,
    /// That somebody wants to hear.
    DeclareSubscriber,
    /// A question.
    Query,
    /// That somebody answers.
    DeclareQueryable,
    /// An answer.
    Reply,
    /// That somebody is there.
    LivelinessToken,
    /// That somebody wants to hear who is there.
    DeclareLivelinessSubscriber,
    /// A question who is there.
    LivelinessQuery,
}

impl LinkMessage {
    /// All of them.
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

    /// Zenoh's word for it.
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

/// What links to bearers of one common name let in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// The common name.
    pub common_name: String,
    /// What is let in, and on which key expressions. Everything else is not.
    pub permits: Vec<(Vec<LinkMessage>, Vec<String>)>,
}

/// The common name of a bearer's certificate.
pub fn common_name(who: &Identity) -> String {
    match &who.principal {
        Principal::Node { .. } => "consort-node".to_owned(),
        Principal::Person { scope, .. } => person(*scope),
    }
}

fn person(scope: AccessScope) -> String {
    format!("consort-{scope}")
}

/// What the links of a fleet's node let in; `aside` are key expressions outside the fleet's tree on which neighbours speak.
pub fn grants(fleet: &FleetId, aside: &[&str]) -> Vec<Grant> {
    let keys = Keys::new(fleet);
    let mut all = vec![format!("consort/{fleet}/**")];
    all.extend(aside.iter().map(|aside| (*aside).to_owned()));
    let node = Grant { common_name: "consort-node".to_owned(), permits: vec![(LinkMessage::ALL.to_vec(), all)] };
    let persons = AccessScope::ALL.iter().map(|scope| Grant {
        common_name: person(*scope),
        permits: vec![
            (vec![LinkMessage::Query], asked(&keys, *scope)),
            (vec![LinkMessage::DeclareSubscriber], heard(&keys)),
            (vec![LinkMessage::DeclareLivelinessSubscriber, LinkMessage::LivelinessQuery], vec![keys.any_alive()]),
        ],
    });
    std::iter::once(node).chain(persons).collect()
}

/// What a person of this scope may ask.
fn asked(keys: &Keys, scope: AccessScope) -> Vec<String> {
    let calls = ApiCall::ALL.iter().filter(|call| required_scope(**call) <= scope);
    let mut asked: Vec<String> = calls.map(|call| keys.write(&Key::Api(*call))).collect();
    asked.extend([keys.any_view(), keys.any_seen_by_any(), keys.any_help(), keys.any_certificate()]);
    if scope >= AccessScope::Operate {
        asked.push(keys.any_leave());
    }
    asked
}

/// What any person may listen to: events, and what pictures of a fleet are drawn of.
fn heard(keys: &Keys) -> Vec<String> {
    vec![keys.any_events(), keys.any_body_state(), keys.write(&Key::Beacon)]
}

/// Which scope a call needs.
pub fn required_scope(call: ApiCall) -> AccessScope {
    match call {
        ApiCall::Get | ApiCall::List | ApiCall::Explain | ApiCall::Help => AccessScope::Read,
        ApiCall::Submit | ApiCall::Cancel => AccessScope::Submit,
        ApiCall::Resolve | ApiCall::Backup | ApiCall::Upgrade => AccessScope::Operate,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_person_asks_what_the_scope_allows_and_says_nothing() {
        use LinkMessage::{DeclareSubscriber, Put, Query, Reply};
        for (scope, submits, operates) in
            [(AccessScope::Read, false, false), (AccessScope::Submit, true, false), (AccessScope::Operate, true, true)]
        {
            assert!(may(scope, Query, "consort/ward/view/**"));
            assert_eq!(may(scope, Query, "consort/ward/api/submit"), submits);
            assert_eq!(may(scope, Query, "consort/ward/api/rescued"), operates);
            assert_eq!(may(scope, Query, "consort/ward/api/leave/*"), operates);
            assert!(may(scope, DeclareSubscriber, "consort/ward/events/**"));
            let grants = grants(&ward(), &[]);
            let own = grants.iter().find(|grant| grant.common_name == person(scope)).unwrap();
            let says =
                own.permits.iter().flat_map(|(passings, _)| passings).any(|passing| [Put, Reply].contains(passing));
            assert!(!says, "{scope}");
        }
    }

    #[test]
    fn the_common_name_is_the_kind_of_bearer() {
        let named = |of: &str| common_name(&format!("consort://ward/{of}").parse().unwrap());
        assert_eq!(named("node/ada?roles=robot,voter"), "consort-node");
        assert_eq!(named("person/ada?scope=read"), "consort-read");
        assert_eq!(named("person/ada?scope=operate"), "consort-operate");
        let granted: Vec<String> = grants(&ward(), &[]).into_iter().map(|grant| grant.common_name).collect();
        assert_eq!(granted, ["consort-node", "consort-read", "consort-submit", "consort-operate"]);
    }

    #[test]
    fn a_nodes_link_carries_its_fleet_and_no_other() {
        let grants = grants(&ward(), &["consort-hearing/*"]);
        assert_eq!(
            grants[0].permits,
            [(LinkMessage::ALL.to_vec(), vec!["consort/ward/**".to_owned(), "consort-hearing/*".to_owned()])]
        );
    }
}
