//! Nodes that do not relay: clients of a relay, which move to another when it fails.

use bytes::Bytes;
use consort_bus::zenoh_bus::Mode;
use consort_bus::{Bus, Encoding, Presence, Stream, ZenohBus, ZenohSettings};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout};

/// Longest wait for an expected event.
const WAIT_MAX: Duration = Duration::from_secs(40);

/// Time in which a client has moved to another relay.
const MOVED_WITHIN: Duration = Duration::from_secs(1);

/// Failures of a relay in a test. The fastest move counts: a test machine may be busy.
const ROUNDS: usize = 3;

async fn relay(connect: &[String]) -> ZenohBus {
    ZenohBus::open(ZenohSettings { connect: connect.to_vec(), ..ZenohSettings::default() }).await.unwrap()
}

async fn client(connect: Vec<String>) -> ZenohBus {
    client_with(ZenohSettings { connect, ..ZenohSettings::default() }).await
}

async fn client_with(settings: ZenohSettings) -> ZenohBus {
    ZenohBus::open(ZenohSettings { mode: Mode::NodeClient, ..settings }).await.unwrap()
}

async fn address(bus: &ZenohBus) -> String {
    bus.listen_addresses().await[0].clone()
}

/// Replies to every query on `key`.
async fn serve(bus: &ZenohBus, key: &'static str) -> JoinHandle<()> {
    let mut queries = bus.serve(key).await.unwrap();
    tokio::spawn(async move {
        while let Some(query) = queries.recv().await {
            // The requester may be gone.
            let _ = query.replier.reply(key, Bytes::new(), Encoding::Wire).await;
        }
    })
}

/// Queries until a reply arrives.
async fn wait_until_answered(bus: &ZenohBus, key: &str, when: &str) {
    let end = Instant::now() + WAIT_MAX;
    loop {
        if let Ok(mut replies) = bus.query(key, Bytes::new(), Duration::from_millis(100)).await
            && replies.recv().await.is_some()
        {
            return;
        }
        assert!(Instant::now() < end, "{when}: {key} does not answer");
        sleep(Duration::from_millis(5)).await;
    }
}

async fn next_change(changes: &mut Stream<Presence>, awaited: &str) -> Presence {
    let change = timeout(WAIT_MAX, changes.recv()).await;
    change.unwrap_or_else(|_| panic!("still waiting for {awaited}")).expect("the bus is open")
}

fn presence(key: &str, alive: bool) -> Presence {
    Presence { key: key.to_owned(), alive }
}

/// A TCP connection to a relay that can fall silent: nothing passes, and no connection closes.
struct Cable {
    address: String,
    cut: watch::Sender<bool>,
}

impl Cable {
    async fn to(bus: &ZenohBus) -> Cable {
        let end = address(bus).await.trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("tcp/{}", listener.local_addr().unwrap());
        let (cut, is_cut) = watch::channel(false);
        tokio::spawn(async move {
            while let Ok((mut near, _)) = listener.accept().await {
                let (end, mut is_cut) = (end.clone(), is_cut.clone());
                tokio::spawn(async move {
                    let Ok(mut far) = TcpStream::connect(end).await else { return };
                    let copied = tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => true,
                        _ = is_cut.wait_for(|cut| *cut) => false,
                    };
                    if !copied {
                        // The connections stay open for as long as the cable is cut.
                        let _ = is_cut.wait_for(|cut| !*cut).await;
                    }
                });
            }
        });
        Cable { address, cut }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_moves_when_its_relay_ends() {
    let far = relay(&[]).await;
    let service = serve(&far, "ended/far").await;
    let mut moves = vec![];
    for round in 0..ROUNDS {
        let first = relay(&far.listen_addresses().await).await;
        let client = client(vec![address(&first).await, address(&far).await]).await;
        let own = serve(&client, "ended/client").await;
        wait_until_answered(&client, "ended/far", "at the first relay").await;
        wait_until_answered(&far, "ended/client", "at the first relay").await;
        let began = Instant::now();
        first.close().await.unwrap();
        wait_until_answered(&client, "ended/far", "after the end of the relay").await;
        wait_until_answered(&far, "ended/client", "after the end of the relay").await;
        moves.push(began.elapsed());
        assert_eq!(client.links().await.len(), 1, "round {round}");
        own.abort();
        client.close().await.unwrap();
    }
    service.abort();
    assert!(moves.iter().any(|took| *took <= MOVED_WITHIN), "{moves:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_moves_when_its_relay_falls_silent() {
    let far = relay(&[]).await;
    let service = serve(&far, "silent/far").await;
    let mut moves = vec![];
    for _ in 0..ROUNDS {
        let first = relay(&far.listen_addresses().await).await;
        let cable = Cable::to(&first).await;
        let client = client(vec![cable.address.clone(), address(&far).await]).await;
        let own = serve(&client, "silent/client").await;
        wait_until_answered(&client, "silent/far", "at the first relay").await;
        wait_until_answered(&far, "silent/client", "at the first relay").await;
        let began = Instant::now();
        cable.cut.send_replace(true);
        wait_until_answered(&client, "silent/far", "after the cut").await;
        wait_until_answered(&far, "silent/client", "after the cut").await;
        moves.push(began.elapsed());
        own.abort();
        client.close().await.unwrap();
        first.close().await.unwrap();
    }
    service.abort();
    assert!(moves.iter().any(|took| *took <= MOVED_WITHIN), "{moves:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_without_a_relay_works_alone_and_finds_one_later() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let address = format!("tcp/{free}");
    let client = client(vec![address.clone()]).await;
    assert_eq!(client.links().await, []);
    let own = serve(&client, "alone/client").await;
    wait_until_answered(&client, "alone/client", "alone").await;
    let late = ZenohBus::open(ZenohSettings { listen: vec![address], ..ZenohSettings::default() }).await.unwrap();
    wait_until_answered(&late, "alone/client", "after the start of the relay").await;
    assert_eq!(client.links().await.len(), 1);
    own.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_move_reports_only_the_tokens_that_stay_away() {
    // The pause before a report, 4.5 s, is longer than a move, even on a busy machine.
    let lease = Duration::from_secs(6);
    let far = relay(&[]).await;
    let first = relay(&far.listen_addresses().await).await;
    let connect = vec![address(&first).await, address(&far).await];
    let client = client_with(ZenohSettings { connect, lease, ..ZenohSettings::default() }).await;
    let mut changes = client.watch("stay/*").await.unwrap();
    let _token = far.announce("stay/far").await.unwrap();
    assert_eq!(next_change(&mut changes, "the token").await, presence("stay/far", true));
    let _gone = first.announce("stay/first").await.unwrap();
    assert_eq!(next_change(&mut changes, "the token of the first relay").await, presence("stay/first", true));
    let at_first = client.id();
    first.close().await.unwrap();
    let end = Instant::now() + WAIT_MAX;
    while client.id() == at_first {
        assert!(Instant::now() < end, "the client stays at its relay");
        sleep(Duration::from_millis(10)).await;
    }
    let _later = far.announce("stay/later").await.unwrap();
    assert_eq!(next_change(&mut changes, "a later token").await, presence("stay/later", true));
    assert_eq!(next_change(&mut changes, "the end of the first relay").await, presence("stay/first", false));
}
