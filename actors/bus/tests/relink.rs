//! Links that break and return before the routes of any node have been updated: messages must pass
//! in both directions afterwards.

use bytes::Bytes;
use consort_bus::{Bus, Encoding, ZenohBus, ZenohSettings};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::broadcast;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

/// Longest wait for an expected event.
const WAIT_MAX: Duration = Duration::from_secs(40);

async fn router(connect: &[String]) -> ZenohBus {
    ZenohBus::open(ZenohSettings { connect: connect.to_vec(), ..ZenohSettings::default() }).await.unwrap()
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

async fn is_answered(bus: &ZenohBus, key: &str) -> bool {
    match bus.query(key, Bytes::new(), Duration::from_millis(500)).await {
        Ok(mut replies) => replies.recv().await.is_some(),
        Err(_) => false, // it has no session at present
    }
}

async fn wait_until_answered(bus: &ZenohBus, key: &str, when: &str) {
    let end = Instant::now() + WAIT_MAX;
    while !is_answered(bus, key).await {
        assert!(Instant::now() < end, "{when}: {key} does not answer");
        sleep(Duration::from_millis(50)).await;
    }
}

/// A TCP relay that can be interrupted for a moment.
struct Cable {
    address: String,
    interrupt: broadcast::Sender<()>,
}

impl Cable {
    async fn to(bus: &ZenohBus) -> Cable {
        let end = bus.listen_addresses().await[0].trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("tcp/{}", listener.local_addr().unwrap());
        let (interrupt, _) = broadcast::channel(4);
        let interrupted = interrupt.clone();
        tokio::spawn(async move {
            while let Ok((mut near, _)) = listener.accept().await {
                let (end, mut interrupted) = (end.clone(), interrupted.subscribe());
                tokio::spawn(async move {
                    let Ok(mut far) = TcpStream::connect(end).await else { return };
                    tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}
                        _ = interrupted.recv() => {}
                    }
                });
            }
        });
        Cable { address, interrupt }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_pass_after_a_short_cut() {
    let far = router(&[]).await;
    let middle = router(&far.listen_addresses().await).await;
    let cable = Cable::to(&middle).await;
    let near = router(std::slice::from_ref(&cable.address)).await;
    let services =
        [serve(&far, "relink/far").await, serve(&middle, "relink/middle").await, serve(&near, "relink/near").await];
    for round in 0..3 {
        for (bus, keys) in [
            (&near, ["relink/middle", "relink/far"]),
            (&middle, ["relink/near", "relink/far"]),
            (&far, ["relink/near", "relink/middle"]),
        ] {
            for key in keys {
                wait_until_answered(bus, key, &format!("after {round} interruptions")).await;
            }
        }
        cable.interrupt.send(()).expect("the relay is in use");
    }
    services.iter().for_each(JoinHandle::abort);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_pass_after_a_fast_replacement() {
    let far = router(&[]).await;
    let middle = router(&far.listen_addresses().await).await;
    let _services = [serve(&far, "replaced/far").await, serve(&middle, "replaced/middle").await];
    let connect = middle.listen_addresses().await;
    for start in 0..4 {
        let near = router(&connect).await;
        let service = serve(&near, "replaced/near").await;
        for key in ["replaced/middle", "replaced/far"] {
            wait_until_answered(&near, key, &format!("after start {start}")).await;
        }
        for bus in [&middle, &far] {
            wait_until_answered(bus, "replaced/near", &format!("after start {start}")).await;
        }
        service.abort();
        near.close().await.unwrap();
    }
}

/// A stock Zenoh router.
async fn stock_router(admin_space: bool) -> (zenoh::Session, Vec<String>) {
    let mut config = zenoh::Config::default();
    for (path, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]"),
        ("scouting/multicast/enabled", "false"),
        ("adminspace/enabled", if admin_space { "true" } else { "false" }),
    ] {
        config.insert_json5(path, value).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let listening = session.info().locators().await.iter().map(ToString::to_string).collect();
    (session, listening)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stock_router_passes_by_its_admin_space() {
    let (_stock, to_stock) = stock_router(true).await;
    let (_silent, to_silent) = stock_router(false).await;
    let (first, second) = (router(&to_stock).await, router(&to_silent).await);
    let (at_stock, at_silent) = (first.id(), second.id());
    let end = Instant::now() + WAIT_MAX;
    // A neighbour without any reply may be unreachable, so the session is reopened; the stock
    // router received as many queries by then.
    while second.id() == at_silent {
        assert!(Instant::now() < end, "the session to a silent neighbour was not reopened");
        sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(first.id(), at_stock);
}
