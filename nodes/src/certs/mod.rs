//! A fleet's certificates, in a folder: the authority, and one folder for each bearer, ready to be carried to its machine.
//!
//! ```text
//!  certs/
//!    authority/   ca.pem  ca.key  revoked.pem  number     never leaves this machine
//!    ada/         ca.pem  cert.pem  key.pem  revoked.pem  is copied to ada's: consort robot --certs ada
//! ```

mod issued;

pub use issued::{CertificateEntry, CertificateState, read_fleet_of_authority};

use crate::config::{Diagnostic, trust_files};
use crate::file::write_atomically;
use consort_actors::trust::issue::{
    CertificateAuthority, IssuedCertificate, RevokedCertificate, Validity, create_authority,
};
use consort_protocol::ids::FleetId;
use consort_protocol::trust::{Identity, Principal};
use issued::read_revocation_list;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const AUTHORITY: &str = "authority";
const DAY: Duration = Duration::from_secs(86_400);

/// How much earlier than now certificates are valid from: for nodes whose clocks are slow.
const SLOW_CLOCKS: Duration = Duration::from_secs(600);

/// A list of what is revoked says when the next is due; nodes do not hold it to that.
const LIST_DUE: Duration = Duration::from_secs(3650 * 86_400);

/// The folder of a fleet's certificates.
pub struct CertificateStore {
    folder: PathBuf,
    ca: String,
    authorising: CertificateAuthority,
}

fn file_error(path: &Path, problem: impl std::fmt::Display) -> Diagnostic {
    Diagnostic::for_file(path.display(), problem)
}

/// The time since 1970, by this machine's clock.
pub fn unix_time() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

impl CertificateStore {
    /// Founds the authority of a fleet in a folder that has none, valid for so many days.
    ///
    /// # Errors
    /// [`Problem`] if there is one already, which is left as it is, or if it cannot be written.
    pub fn create_authority(folder: &Path, fleet: &FleetId, days: u32) -> Result<(), Diagnostic> {
        let authority = folder.join(AUTHORITY);
        if authority.join("ca.pem").exists() {
            return Err(file_error(
                &authority,
                "there is an authority already; whoever holds its certificates trusts no other",
            ));
        }
        let issued = create_authority(fleet, validity(days)).map_err(|problem| file_error(&authority, problem))?;
        create(&authority)?;
        write_secret(&authority.join("ca.key"), &issued.key)?;
        write(&authority.join("ca.pem"), &issued.certificate)?;
        let certs = CertificateStore::open(folder)?;
        certs.write_list(&[])
    }

    /// The certificates of a folder with an authority.
    ///
    /// # Errors
    /// [`Problem`] of the folder.
    pub fn open(folder: &Path) -> Result<CertificateStore, Diagnostic> {
        let authority = folder.join(AUTHORITY);
        if !authority.join("ca.pem").exists() {
            let what = "there is no authority here; `consort cert init --fleet NAME` founds one";
            return Err(file_error(folder, what));
        }
        let (ca, key) = (read(&authority.join("ca.pem"))?, read(&authority.join("ca.key"))?);
        let authorising = CertificateAuthority::from_pem(&ca, &key)
            .map_err(|problem| file_error(&authority.join("ca.key"), problem))?;
        Ok(CertificateStore { folder: folder.to_owned(), ca, authorising })
    }

    /// Gives a bearer a certificate, in a folder of its name, which is returned. Refuses where there is one already, unless it is
    /// to be `renewed`: then it has a new key, too, and the former certificate remains valid until it expires or is revoked.
    ///
    /// # Errors
    /// [`Problem`]; a folder that is there is left as it is.
    pub fn issue(&self, to: &Identity, addresses: &[String], days: u32, renewed: bool) -> Result<PathBuf, Diagnostic> {
        let name = match &to.principal {
            Principal::Node { name, .. } => name.as_str(),
            Principal::Person { name, .. } => name.as_str(),
        };
        let folder = self.folder.join(name);
        if name == AUTHORITY {
            return Err(file_error(&folder, "that is where the authority is: nobody else can be called so"));
        }
        if folder.exists() && !renewed {
            return Err(file_error(
                &folder,
                "it is there already; `consort cert renew` makes a new certificate and key",
            ));
        }
        let issued =
            self.authorising.issue(to, addresses, validity(days)).map_err(|problem| file_error(&folder, problem))?;
        let IssuedCertificate { certificate, key } = issued;
        create(&folder)?;
        let files = trust_files(&folder);
        write_secret(&files.key, &key)?;
        write(&files.certificate, &certificate)?;
        write(&files.authority, &self.ca)?;
        write(&folder.join("revoked.pem"), &read(&self.list())?)?;
        Ok(folder)
    }

    /// All bearers, by the folders that are there.
    ///
    /// # Errors
    /// [`Problem`] of a folder, or of a certificate in it.
    pub fn certificates(&self) -> Result<Vec<CertificateEntry>, Diagnostic> {
        let revoked = self.revoked()?;
        let entries = fs::read_dir(&self.folder).map_err(|problem| file_error(&self.folder, problem))?;
        let mut folders: Vec<PathBuf> = entries.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect();
        folders.retain(|folder| folder.join("cert.pem").exists());
        folders.sort();
        let read = |folder: &PathBuf| CertificateEntry::read(&folder.join("cert.pem"), &revoked);
        folders.iter().map(read).collect()
    }

    /// The bearer of a name.
    ///
    /// # Errors
    /// [`Problem`] if there is none.
    pub fn certificate(&self, name: &str) -> Result<CertificateEntry, Diagnostic> {
        let file = self.folder.join(name).join("cert.pem");
        if !file.exists() {
            let names: Vec<String> = self.certificates()?.into_iter().map(|holder| holder.name).collect();
            let known = if names.is_empty() { "nobody yet".to_owned() } else { names.join(", ") };
            return Err(file_error(&self.folder, format!("nobody here is called {name:?}; there are: {known}")));
        }
        CertificateEntry::read(&file, &self.revoked()?)
    }

    /// Revokes the certificate of a bearer, and puts the new list into all bearers' folders, which are returned.
    ///
    /// # Errors
    /// [`Problem`] if there is no such bearer, or a file cannot be written.
    pub fn revoke(&self, name: &str) -> Result<Vec<PathBuf>, Diagnostic> {
        let holder = self.certificate(name)?;
        let mut revoked = self.revoked()?;
        if !revoked.iter().any(|known| known.serial == holder.serial) {
            revoked.push(RevokedCertificate { serial: holder.serial, since: unix_time() });
        }
        self.write_list(&revoked)?;
        let list = read(&self.list())?;
        let mut written = Vec::new();
        for holder in self.certificates()? {
            let file = self.folder.join(&holder.name).join("revoked.pem");
            write(&file, &list)?;
            written.push(file);
        }
        Ok(written)
    }

    /// The fleet that the authority is for.
    ///
    /// # Errors
    /// [`Problem`] if its certificate does not say.
    pub fn fleet(&self) -> Result<FleetId, Diagnostic> {
        read_fleet_of_authority(&self.folder.join(AUTHORITY).join("ca.pem"))
    }

    fn list(&self) -> PathBuf {
        self.folder.join(AUTHORITY).join("revoked.pem")
    }

    fn revoked(&self) -> Result<Vec<RevokedCertificate>, Diagnostic> {
        read_revocation_list(&self.list())
    }

    /// Writes the list of what is revoked; its number is one more than the last one's.
    fn write_list(&self, revoked: &[RevokedCertificate]) -> Result<(), Diagnostic> {
        let counter = self.folder.join(AUTHORITY).join("number");
        let last = fs::read_to_string(&counter).ok().and_then(|text| text.trim().parse::<u64>().ok()).unwrap_or(0);
        let validity = Validity { from: unix_time(), until: unix_time() + LIST_DUE };
        let list = self
            .authorising
            .revocation_list(revoked, last + 1, validity)
            .map_err(|problem| file_error(&self.list(), problem))?;
        write(&self.list(), &list)?;
        write(&counter, &format!("{}\n", last + 1))
    }
}

fn validity(days: u32) -> Validity {
    Validity { from: unix_time().saturating_sub(SLOW_CLOCKS), until: unix_time() + DAY * days }
}

fn create(folder: &Path) -> Result<(), Diagnostic> {
    fs::create_dir_all(folder).map_err(|problem| file_error(folder, problem))
}

fn read(file: &Path) -> Result<String, Diagnostic> {
    fs::read_to_string(file).map_err(|problem| file_error(file, problem))
}

/// Writes a file as a whole or not at all: a node may be reading it.
fn write(file: &Path, text: &str) -> Result<(), Diagnostic> {
    write_atomically(file, text, 0o644)
}

/// The same of a file that only its owner may read.
fn write_secret(file: &Path, text: &str) -> Result<(), Diagnostic> {
    write_atomically(file, text, 0o600)
}
