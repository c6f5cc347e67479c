//! A bus on which every message between nodes bears its author's seal.

use super::cards::Cards;
use super::files::TrustFiles;
use super::keyring::{Card, Keyring};
use super::notary::Signatory;
use super::refusals::Refusals;
use crate::bus::{
    Bus, BusError, Delivery, Encoding, Link, Presence, Query, Replier, Reply, Sample, SharedBus, Stream, Token,
};
use crate::clock::Clock;
use crate::gossip::SharedNotary;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{Act, Fingerprint, Freshness, Kind, Window, check, open, signed_part};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// A bus that seals what is said below `wire/`, and hands out only what its author sealed, may say, and says for the first
/// time. Everything else passes as it is: it is for anybody's clients, who seal nothing.
pub struct SealedBus {
    bus: SharedBus,
    keys: Keys,
    trust: Arc<Trust>,
}

/// What is needed to believe.
struct Trust {
    keyring: Arc<Keyring>,
    cards: Arc<Cards>,
    refusals: Arc<Refusals>,
}

impl SealedBus {
    /// Seals what is said on `bus` with `keyring`, which was opened from `files`.
    ///
    /// # Errors
    /// [`BusError`] if the own certificate cannot be shown.
    pub async fn open(
        bus: SharedBus,
        keys: Keys,
        keyring: Arc<Keyring>,
        files: TrustFiles,
        clock: Clock,
    ) -> Result<SealedBus, BusError> {
        let refusals = Arc::new(Refusals::default());
        let (on, ring, told) = (Arc::clone(&bus), Arc::clone(&keyring), Arc::clone(&refusals));
        let cards = Cards::open(on, keys.clone(), ring, files, clock, told).await?;
        Ok(SealedBus { bus, keys, trust: Arc::new(Trust { keyring, cards: Arc::new(cards), refusals }) })
    }

    /// Who signs what the bearer says of itself, and judges what others hand on of third ones.
    pub fn notary(&self) -> SharedNotary {
        let Trust { keyring, cards, .. } = &*self.trust;
        Arc::new(Signatory { keyring: Arc::clone(keyring), cards: Arc::clone(cards) })
    }

    /// Whether what is said on a key, or key expression, is sealed: whatever nodes say to one another, but for certificates,
    /// which prove themselves.
    fn is_sealed(&self, key: &str) -> bool {
        self.below(key).is_some_and(|below| below.starts_with("wire/") && !below.starts_with("wire/card/"))
    }

    fn below<'a>(&self, key: &'a str) -> Option<&'a str> {
        self.keys.below(key)
    }

    fn samples(&self, samples: Stream<Sample>) -> Stream<Sample> {
        let (trust, keys, mut windows) = (Arc::clone(&self.trust), self.keys.clone(), Windows::default());
        samples.sifting(move |sample| {
            let heard = Heard { kind: Kind::Publication, key: &sample.key, bytes: &sample.payload };
            match trust.believe(&keys, Act::Publish, heard, Some(&mut windows)) {
                Ok(believed) => {
                    let payload = believed.payload(&sample.payload);
                    Some(Sample { payload, ..sample })
                }
                Err(_) => None,
            }
        })
    }

    fn questions(&self, questions: Stream<Query>) -> Stream<Query> {
        let (trust, keys, mut windows) = (Arc::clone(&self.trust), self.keys.clone(), Windows::default());
        questions.sifting(move |query| {
            let heard = Heard { kind: Kind::Question, key: &query.key, bytes: &query.payload };
            match trust.believe(&keys, Act::Ask, heard, Some(&mut windows)) {
                Ok(believed) => {
                    let payload = believed.payload(&query.payload);
                    let asked = Kind::Answer(believed.by, believed.number);
                    let keyring = Arc::clone(&trust.keyring);
                    let replier = Box::new(SealedReplier { replier: query.replier, keyring, asked });
                    Some(Query { payload, replier, ..query })
                }
                Err(reason) => {
                    // Whoever asks in good faith need not wait for its limit.
                    tokio::spawn(async move { query.replier.refuse(&reason).await });
                    None
                }
            }
        })
    }

    /// Seals a question, asks it, and reads the answers.
    async fn asked<F>(
        &self,
        key_expr: &str,
        payload: Bytes,
        ask: impl FnOnce(Bytes) -> F,
    ) -> Result<Stream<Reply>, BusError>
    where
        F: Future<Output = Result<Stream<Reply>, BusError>>,
    {
        if !self.is_sealed(key_expr) {
            return ask(payload).await;
        }
        let keyring = &self.trust.keyring;
        let (number, own) = (keyring.number(), keyring.fingerprint());
        // What is asked reaches whoever answers without its parameters.
        let key = key_expr.split('?').next().unwrap_or_default();
        let replies = ask(keyring.seal(Kind::Question, number, key, &payload).into()).await?;
        let (trust, keys) = (Arc::clone(&self.trust), self.keys.clone());
        Ok(replies.sifting(move |reply| {
            let Ok(bytes) = &reply.payload else { return Some(reply) };
            let heard = Heard { kind: Kind::Answer(own, number), key: &reply.key, bytes };
            let believed = trust.believe(&keys, Act::Answer, heard, None).ok()?;
            let payload = Ok(believed.payload(bytes));
            Some(Reply { payload, ..reply })
        }))
    }
}

/// Something that was heard.
struct Heard<'a> {
    kind: Kind,
    key: &'a str,
    bytes: &'a Bytes,
}

/// Something that is believed.
struct Believed {
    by: Fingerprint,
    number: u64,
    length: usize,
}

impl Believed {
    /// The message itself: it stands at the end.
    fn payload(&self, bytes: &Bytes) -> Bytes {
        bytes.slice(bytes.len() - self.length..)
    }
}

/// What was heard of each author, at one place.
type Windows = BTreeMap<Fingerprint, Window>;

impl Trust {
    /// Whether something heard is from who it says, who may say it; and, of what is not an answer, for the first time.
    fn believe(
        &self,
        keys: &Keys,
        act: Act,
        heard: Heard<'_>,
        windows: Option<&mut Windows>,
    ) -> Result<Believed, String> {
        let Heard { kind, key, bytes } = heard;
        let below = keys.below(key).unwrap_or(key);
        let refused = |reason: String| {
            self.refusals.note(reason.clone());
            Err(reason)
        };
        let sealed = match open(kind, bytes) {
            Ok(sealed) => sealed,
            Err(problem) => return refused(format!("somebody on {below}: {problem}")),
        };
        let card = match self.keyring.card(sealed.by) {
            Some(card) => card,
            None => {
                self.cards.want(sealed.by);
                return Err(format!("certificate {} is not known here yet: ask again", sealed.by));
            }
        };
        if !card.signed(&signed_part(kind, sealed.by, sealed.number, key, sealed.payload), sealed.signature) {
            return refused(format!(
                "somebody on {below} says to be {}, whose signature it is not",
                card.identity.bearer
            ));
        }
        if let Err(denied) = check(&card.identity, act, below, sealed.payload) {
            return refused(denied.to_string());
        }
        if let Some(windows) = windows {
            match windows.entry(sealed.by).or_default().hear(sealed.number) {
                Freshness::New => {}
                Freshness::Repeated => return Err("it was heard before".to_owned()),
                Freshness::Old => return refused(late(&card, below)),
            }
        }
        Ok(Believed { by: sealed.by, number: sealed.number, length: sealed.payload.len() })
    }
}

fn late(card: &Card, below: &str) -> String {
    let bearer = &card.identity.bearer;
    format!(
        "what {bearer} says on {below} is older than what it said before: somebody repeats it, or its clock was put back"
    )
}

#[async_trait]
impl Bus for SealedBus {
    async fn publish(&self, key: &str, payload: Bytes, encoding: Encoding, delivery: Delivery) -> Result<(), BusError> {
        let payload = if self.is_sealed(key) {
            let keyring = &self.trust.keyring;
            keyring.seal(Kind::Publication, keyring.number(), key, &payload).into()
        } else {
            payload
        };
        self.bus.publish(key, payload, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let samples = self.bus.subscribe(key_expr).await?;
        Ok(if self.is_sealed(key_expr) { self.samples(samples) } else { samples })
    }

    async fn query(&self, key_expr: &str, payload: Bytes, limit: Duration) -> Result<Stream<Reply>, BusError> {
        self.asked(key_expr, payload, |payload| self.bus.query(key_expr, payload, limit)).await
    }

    async fn query_nearest(&self, key_expr: &str, payload: Bytes, limit: Duration) -> Result<Stream<Reply>, BusError> {
        self.asked(key_expr, payload, |payload| self.bus.query_nearest(key_expr, payload, limit)).await
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        let questions = self.bus.serve(key_expr).await?;
        Ok(if self.is_sealed(key_expr) { self.questions(questions) } else { questions })
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        let questions = self.bus.serve_complete(key_expr).await?;
        Ok(if self.is_sealed(key_expr) { self.questions(questions) } else { questions })
    }

    async fn announce(&self, key: &str) -> Result<Token, BusError> {
        self.bus.announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.bus.watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.bus.links().await
    }
}

/// Answers one question, sealed as the answer to it.
struct SealedReplier {
    replier: Box<dyn Replier>,
    keyring: Arc<Keyring>,
    asked: Kind,
}

#[async_trait]
impl Replier for SealedReplier {
    async fn reply(&self, key: &str, payload: Bytes, encoding: Encoding) -> Result<(), BusError> {
        let sealed = self.keyring.seal(self.asked, self.keyring.number(), key, &payload);
        self.replier.reply(key, sealed.into(), encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.replier.refuse(reason).await
    }
}
