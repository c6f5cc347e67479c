//! Requests that change the fleet: each is signed for a person, and verified by the node that
//! executes it.

use crate::fixture::*;
use bytes::Bytes;
use consort_bus::trust::{SigningBus, forwarded_part};
use consort_bus::{Bus, Query, RequestAuthor, RequestAuthority, ServiceSelection, Stream};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::trust::{AccessScope, MissionRights, REQUEST_SKEW_MAX_MS};
use std::time::Duration;

/// A coordinator, and what it receives.
struct Coordinator {
    fixture: Fixture,
    bus: SigningBus,
    queries: Stream<Query>,
}

impl Coordinator {
    async fn start() -> Coordinator {
        let fixture = Fixture::new();
        let bus = fixture.node("ada", "consort://ward/node/ada?roles=voter").await;
        let queries = bus.serve("consort/ward/api/**").await.unwrap();
        Coordinator { fixture, bus, queries }
    }

    /// Sends a request and returns it as the coordinator receives it.
    async fn receive(&mut self, from: &dyn Bus, key: &Key, attachment: &[u8]) -> Option<Query> {
        let key = keys().write(key);
        let attachment = Bytes::copy_from_slice(attachment);
        let second = Duration::from_secs(1);
        let _replies = from.query_with(&key, "{}".into(), attachment, second, ServiceSelection::All).await.unwrap();
        tokio::time::timeout(Duration::from_secs(5), self.queries.recv()).await.ok().flatten()
    }

    /// Returns the author of a call, or the error of the reply.
    async fn author(&mut self, from: &dyn Bus, call: ApiCall, attachment: &[u8]) -> Result<RequestAuthor, String> {
        self.author_of(from, &Key::Api(call), attachment).await
    }

    /// Returns the author of a request, or the error of the reply.
    async fn author_of(&mut self, from: &dyn Bus, key: &Key, attachment: &[u8]) -> Result<RequestAuthor, String> {
        match self.receive(from, key, attachment).await.expect("a request").authority {
            RequestAuthority::Verified(requester) => Ok(requester.author),
            RequestAuthority::Rejected(reply) => Err(reply.error),
            RequestAuthority::Unchecked => panic!("the request was not checked"),
        }
    }
}

/// Returns the keys of all requests that change something.
fn changes() -> impl Iterator<Item = Key> {
    let calls = ApiCall::ALL.iter().copied().filter(|call| !call.is_read_only());
    calls.map(Key::Api).chain([Key::Leave(node("ada"))])
}

fn kim(through: Option<&str>) -> Result<RequestAuthor, String> {
    Ok(RequestAuthor { name: "kim".parse().unwrap(), missions: MissionRights::All, through: through.map(node) })
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_request_needs_a_person_with_its_scope() {
    let mut ada = Coordinator::start().await;
    let kim_bus = ada.fixture.node("kim", "consort://ward/person/kim?scope=submit").await;
    assert_eq!(ada.author(&kim_bus, ApiCall::Submit, b"").await, kim(None));
    let orders = [ApiCall::Hold, ApiCall::Release, ApiCall::Maintenance];
    let of_missions = [ApiCall::Cancel, ApiCall::CancelMissions, ApiCall::Priority, ApiCall::Reassign];
    let of_map = [ApiCall::Close, ApiCall::Open, ApiCall::Limit, ApiCall::Alarm];
    for call in of_missions.into_iter().chain(of_map).chain(orders) {
        assert_eq!(ada.author(&kim_bus, call, b"").await, kim(None));
    }
    let scope = "the certificate of kim has scope submit; this request needs scope operate";
    let operating = [ApiCall::Resolve, ApiCall::Backup, ApiCall::Upgrade].map(Key::Api);
    for key in operating.into_iter().chain([Key::Leave(node("ada"))]) {
        assert_eq!(ada.author_of(&kim_bus, &key, b"").await, Err(scope.to_owned()), "{key:?}");
    }
    let lee = ada.fixture.node("lee", "consort://ward/person/lee?scope=read").await;
    for key in changes() {
        let refused = ada.author_of(&lee, &key, b"").await.unwrap_err();
        assert!(refused.starts_with("the certificate of lee has scope read; this request needs"), "{key:?}: {refused}");
    }
    let plain = ada.fixture.plain("mallory");
    let unsigned = ada.author(&*plain, ApiCall::Submit, b"").await.unwrap_err();
    assert!(unsigned.starts_with("it is not signed: this fleet is closed"), "{unsigned}");
    // What changes nothing needs no signature.
    let list = Key::Api(ApiCall::List);
    assert_eq!(ada.receive(&*plain, &list, b"").await.unwrap().authority, RequestAuthority::Unchecked);
}

/// Sends each request that changes something with the certificate of a node with these roles.
async fn assert_makes_no_requests(roles: &str) {
    let mut ada = Coordinator::start().await;
    let eve = ada.fixture.node("eve", &format!("consort://ward/node/eve?roles={roles}")).await;
    let rejection = "may not make requests; a person signs them";
    for key in changes() {
        let refused = ada.author_of(&eve, &key, b"").await.unwrap_err();
        assert!(refused.starts_with("node eve (") && refused.ends_with(rejection), "{roles}: {key:?}: {refused}");
    }
    assert!(ada.bus.rejections().iter().any(|reason| reason.contains(rejection)), "{:?}", ada.bus.rejections());
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_robot_or_a_voter_makes_no_requests() {
    assert_makes_no_requests("robot").await;
    assert_makes_no_requests("voter").await;
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_node_without_a_role_makes_no_requests() {
    assert_makes_no_requests("").await;
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_dashboard_makes_no_requests_without_a_token() {
    assert_makes_no_requests("dashboard").await;
}

/// Signs a request, or forwards a token.
#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn the_author_of_a_request_has_the_missions_of_the_certificate() {
    let mut ada = Coordinator::start().await;
    let identity = "consort://ward/person/kim?scope=submit&missions=deliveries";
    let allowed: MissionRights = "deliveries".parse().unwrap();
    let kim_bus = ada.fixture.node("kim", identity).await;
    assert_eq!(ada.author(&kim_bus, ApiCall::Submit, b"").await.unwrap().missions, allowed);
    let issued = ada.fixture.authority().issue(&identity.parse().unwrap(), &[], LONG).unwrap();
    let person = ada.fixture.files("kim-2", &issued).open(&ward(), NOW, 1).unwrap();
    let token = person.issue_token(AccessScope::Submit, NOW + Duration::from_secs(60)).unwrap();
    let page = ada.fixture.node("page", "consort://ward/node/page?roles=dashboard").await;
    let author = ada.author(&page, ApiCall::Submit, forwarded_part(&token).as_bytes()).await.unwrap();
    assert_eq!((author.missions, author.through), (allowed, Some(node("page"))));
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_driver_server_makes_no_requests() {
    assert_makes_no_requests("host&serves=bob,clerk").await;
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_token_is_forwarded_only_by_a_dashboard() {
    let mut ada = Coordinator::start().await;
    let identity = "consort://ward/person/kim?scope=operate".parse().unwrap();
    let issued = ada.fixture.authority().issue(&identity, &[], LONG).unwrap();
    let person = ada.fixture.files("kim", &issued).open(&ward(), NOW, 1).unwrap();
    let token = person.issue_token(AccessScope::Submit, NOW + Duration::from_secs(60)).unwrap();
    let forwarded = forwarded_part(&token).as_bytes();
    let page = ada.fixture.node("page", "consort://ward/node/page?roles=dashboard").await;
    assert_eq!(ada.author(&page, ApiCall::Submit, forwarded).await, kim(Some("page")));
    assert!(ada.author(&page, ApiCall::Submit, b"").await.is_err(), "a dashboard grants nothing itself");
    let scope = ada.author(&page, ApiCall::Resolve, forwarded).await.unwrap_err();
    assert!(scope.contains("kim has scope submit"), "the scope of the token counts: {scope}");
    let forged = ada.author(&page, ApiCall::Submit, b"a.b.c").await.unwrap_err();
    assert!(forged.starts_with("invalid token"), "{forged}");
    let eve = ada.fixture.node("eve", "consort://ward/node/eve?roles=robot,voter,host").await;
    let stolen = ada.author(&eve, ApiCall::Submit, forwarded).await.unwrap_err();
    assert!(stolen.starts_with("node eve (robot, voter, host) may not forward"), "{stolen}");
    tokio::time::sleep(Duration::from_secs(61)).await;
    let expired = ada.author(&page, ApiCall::Submit, forwarded).await.unwrap_err();
    assert!(expired.contains("expired"), "{expired}");
}

#[tokio::test(flavor = "current_thread", start_paused = true)]
async fn a_request_cannot_be_repeated_moved_or_changed() {
    let mut ada = Coordinator::start().await;
    let relay = ada.fixture.plain("relay");
    let mut intercepted = relay.serve(&keys().any_api()).await.unwrap();
    let kim_bus = ada.fixture.node("kim", "consort://ward/person/kim?scope=operate").await;
    assert_eq!(ada.author(&kim_bus, ApiCall::Cancel, b"").await, kim(None));
    let request = intercepted.recv().await.unwrap();
    assert!(ada.receive(&*relay, &Key::Api(ApiCall::Cancel), &request.attachment).await.is_none(), "repeated");
    let other = "the signature is not by person kim (operate)";
    assert_eq!(ada.author(&*relay, ApiCall::Resolve, &request.attachment).await, Err(other.to_owned()), "moved");
    for index in 0..request.attachment.len() {
        let mut changed = request.attachment.to_vec();
        changed[index] ^= 1;
        assert!(ada.author(&*relay, ApiCall::Cancel, &changed).await.is_err(), "byte {index} is changed");
    }
    // A node that has not received the request accepts it for a limited time.
    let bob = ada.fixture.node("bob", "consort://ward/node/bob?roles=voter").await;
    ada.queries = bob.serve(&keys().any_api()).await.unwrap();
    tokio::time::sleep(Duration::from_millis(REQUEST_SKEW_MAX_MS + 1000)).await;
    let old = ada.author(&*relay, ApiCall::Cancel, &request.attachment).await.unwrap_err();
    assert!(old.starts_with("it was signed") && old.ends_with("compare the clocks"), "{old}");
}
