//! A bus on which every message between nodes bears its author's seal.

use super::cards::Cards;
use super::files::TrustFiles;
use super::keyring::{Card, Keyring};
use super::refusals::Refusals;
use crate::bus::{BusError, Encoding, Layer, Query, Replier, Reply, Sample, SharedBus, Stream, turn_away};
use crate::clock::Clock;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{Act, Fingerprint, Freshness, Kind, Window, check, open, signed_part};
use std::collections::BTreeMap;
use std::sync::Arc;

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
    cards: Cards,
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
        Ok(SealedBus { bus, keys, trust: Arc::new(Trust { keyring, cards, refusals }) })
    }

    /// Whether what is said on a key, or key expression, is sealed: whatever nodes say to one another, but for certificates,
    /// which prove themselves.
    fn is_sealed(&self, key: &str) -> bool {
        self.below(key).is_some_and(|below| below.starts_with("wire/") && !below.starts_with("wire/card/"))
    }

    fn below<'a>(&self, key: &'a str) -> Option<&'a str> {
        self.keys.below(key)
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

impl Layer for SealedBus {
    /// The number of a question that was sealed.
    type Asked = Option<u64>;

    fn carrier(&self) -> &SharedBus {
        &self.bus
    }

    fn publication(&self, key: &str, payload: Bytes) -> Result<Bytes, BusError> {
        if !self.is_sealed(key) {
            return Ok(payload);
        }
        let keyring = &self.trust.keyring;
        Ok(keyring.seal(Kind::Publication, keyring.number(), key, &payload).into())
    }

    fn publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample> {
        if !self.is_sealed(key_expr) {
            return samples;
        }
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

    fn question(&self, key_expr: &str, payload: Bytes) -> Result<(Bytes, Option<u64>), BusError> {
        if !self.is_sealed(key_expr) {
            return Ok((payload, None));
        }
        let keyring = &self.trust.keyring;
        let number = keyring.number();
        // What is asked reaches whoever answers without its parameters.
        let key = key_expr.split('?').next().unwrap_or_default();
        Ok((keyring.seal(Kind::Question, number, key, &payload).into(), Some(number)))
    }

    fn answers(&self, asked: Option<u64>, replies: Stream<Reply>) -> Stream<Reply> {
        let Some(number) = asked else { return replies };
        let (trust, keys) = (Arc::clone(&self.trust), self.keys.clone());
        replies.sifting(move |reply| {
            let Ok(bytes) = &reply.payload else { return Some(reply) };
            let kind = Kind::Answer(trust.keyring.fingerprint(), number);
            let heard = Heard { kind, key: &reply.key, bytes };
            let believed = trust.believe(&keys, Act::Answer, heard, None).ok()?;
            let payload = Ok(believed.payload(bytes));
            Some(Reply { payload, ..reply })
        })
    }

    fn questions(&self, key_expr: &str, questions: Stream<Query>) -> Stream<Query> {
        if !self.is_sealed(key_expr) {
            return questions;
        }
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
                    turn_away(query, reason);
                    None
                }
            }
        })
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
