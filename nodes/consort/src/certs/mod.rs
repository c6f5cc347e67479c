//! A fleet's certificates in a folder: the authority, and a folder for each principal, ready to be
//! copied to its machine.
//!
//! ```text
//!  certs/
//!    authority/   ca.pem  ca.key  revoked.pem  number     never leaves this machine
//!    ada/         ca.pem  cert.pem  key.pem  revoked.pem  is copied to ada's: consort robot --certs ada
//! ```

mod issued;

pub(crate) use issued::read_fleet_of_authority;
pub use issued::{CertificateEntry, CertificateState};

use crate::config::trust_files;
use crate::diagnostic::Diagnostic;
use crate::file::write_atomically;
use consort_bus::trust::issue::{
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

/// Certificates are valid from this long before now: for nodes with slow clocks.
const SLOW_CLOCKS: Duration = Duration::from_secs(600);

/// Time until the next revocation list is due, as written in the list. Nodes do not enforce it.
const LIST_DUE: Duration = Duration::from_secs(3650 * 86_400);

/// The folder of a fleet's certificates.
pub struct CertificateStore {
    folder: PathBuf,
    ca: String,
    authority_key: CertificateAuthority,
}

fn file_error(path: &Path, problem: impl std::fmt::Display) -> Diagnostic {
    Diagnostic::for_file(path.display(), problem)
}

/// Returns the time since 1970 by this machine's clock.
pub fn unix_time() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

impl CertificateStore {
    /// Creates the authority of a fleet in a folder that has none, valid for `days`.
    ///
    /// # Errors
    /// [`Diagnostic`] if there is an authority already, which stays unchanged, or if the files
    /// cannot be written.
    pub fn create_authority(folder: &Path, fleet: &FleetId, days: u32) -> Result<(), Diagnostic> {
        let authority = folder.join(AUTHORITY);
        if authority.join("ca.pem").exists() {
            return Err(file_error(
                &authority,
                "there is an authority already; the holders of its certificates trust no other",
            ));
        }
        let issued = create_authority(fleet, validity(days)).map_err(|problem| file_error(&authority, problem))?;
        create(&authority)?;
        write_secret(&authority.join("ca.key"), &issued.key)?;
        write(&authority.join("ca.pem"), &issued.certificate)?;
        let certs = CertificateStore::open(folder)?;
        certs.write_list(&[])
    }

    /// Opens the certificates of a folder with an authority.
    ///
    /// # Errors
    /// [`Diagnostic`] of the folder.
    pub fn open(folder: &Path) -> Result<CertificateStore, Diagnostic> {
        let authority = folder.join(AUTHORITY);
        if !authority.join("ca.pem").exists() {
            let what = "there is no authority here; `consort cert init --fleet NAME` creates it";
            return Err(file_error(folder, what));
        }
        let (ca, key) = (read(&authority.join("ca.pem"))?, read(&authority.join("ca.key"))?);
        let authority_key = CertificateAuthority::from_pem(&ca, &key)
            .map_err(|problem| file_error(&authority.join("ca.key"), problem))?;
        Ok(CertificateStore { folder: folder.to_owned(), ca, authority_key })
    }

    /// Issues a certificate to a principal, in a folder of its name, which is returned. It is
    /// refused if the folder exists, unless `renewed` is set: then a new certificate and key are
    /// made, and the former certificate remains valid until it expires or is revoked.
    ///
    /// # Errors
    /// [`Diagnostic`]; an existing folder stays unchanged.
    pub fn issue(&self, to: &Identity, addresses: &[String], days: u32, renewed: bool) -> Result<PathBuf, Diagnostic> {
        let name = match &to.principal {
            Principal::Node { name, .. } => name.as_str(),
            Principal::Person { name, .. } => name.as_str(),
        };
        let folder = self.folder.join(name);
        if name == AUTHORITY {
            return Err(file_error(&folder, "this name is reserved for the authority: choose another name"));
        }
        if folder.exists() && !renewed {
            return Err(file_error(&folder, "it exists already; `consort cert renew` makes a new certificate and key"));
        }
        let issued =
            self.authority_key.issue(to, addresses, validity(days)).map_err(|problem| file_error(&folder, problem))?;
        let IssuedCertificate { certificate, key } = issued;
        create(&folder)?;
        let files = trust_files(&folder);
        write_secret(&files.key, &key)?;
        write(&files.certificate, &certificate)?;
        write(&files.authority, &self.ca)?;
        write(&folder.join("revoked.pem"), &read(&self.list())?)?;
        Ok(folder)
    }

    /// Returns the certificates of all principals, by the folders that exist.
    ///
    /// # Errors
    /// [`Diagnostic`] of a folder, or of a certificate in it.
    pub(crate) fn certificates(&self) -> Result<Vec<CertificateEntry>, Diagnostic> {
        let revoked = self.revoked()?;
        let entries = fs::read_dir(&self.folder).map_err(|problem| file_error(&self.folder, problem))?;
        let mut folders: Vec<PathBuf> = entries.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect();
        folders.retain(|folder| folder.join("cert.pem").exists());
        folders.sort();
        let read = |folder: &PathBuf| CertificateEntry::read(&folder.join("cert.pem"), &revoked);
        folders.iter().map(read).collect()
    }

    /// Returns the certificate of a principal.
    ///
    /// # Errors
    /// [`Diagnostic`] if there is none.
    pub(crate) fn certificate(&self, name: &str) -> Result<CertificateEntry, Diagnostic> {
        let file = self.folder.join(name).join("cert.pem");
        if !file.exists() {
            let names: Vec<String> = self.certificates()?.into_iter().map(|entry| entry.name).collect();
            let known = if names.is_empty() { "no certificates yet".to_owned() } else { names.join(", ") };
            return Err(file_error(&self.folder, format!("there is no certificate of {name:?}; there are: {known}")));
        }
        CertificateEntry::read(&file, &self.revoked()?)
    }

    /// Revokes a principal's certificate, and writes the new list into all folders. Returns the
    /// written files.
    ///
    /// # Errors
    /// [`Diagnostic`] if there is no such principal, or a file cannot be written.
    pub(crate) fn revoke(&self, name: &str) -> Result<Vec<PathBuf>, Diagnostic> {
        let entry = self.certificate(name)?;
        let mut revoked = self.revoked()?;
        if !revoked.iter().any(|known| known.serial == entry.serial) {
            revoked.push(RevokedCertificate { serial: entry.serial, since: unix_time() });
        }
        self.write_list(&revoked)?;
        let list = read(&self.list())?;
        let mut written = Vec::new();
        for entry in self.certificates()? {
            let file = self.folder.join(&entry.name).join("revoked.pem");
            write(&file, &list)?;
            written.push(file);
        }
        Ok(written)
    }

    /// Returns the fleet of the authority.
    ///
    /// # Errors
    /// [`Diagnostic`] if the fleet is not in its certificate.
    pub fn fleet(&self) -> Result<FleetId, Diagnostic> {
        read_fleet_of_authority(&self.folder.join(AUTHORITY).join("ca.pem"))
    }

    fn list(&self) -> PathBuf {
        self.folder.join(AUTHORITY).join("revoked.pem")
    }

    fn revoked(&self) -> Result<Vec<RevokedCertificate>, Diagnostic> {
        read_revocation_list(&self.list())
    }

    /// Writes the revocation list. Its number is the last number plus 1.
    fn write_list(&self, revoked: &[RevokedCertificate]) -> Result<(), Diagnostic> {
        let counter = self.folder.join(AUTHORITY).join("number");
        let last = fs::read_to_string(&counter).ok().and_then(|text| text.trim().parse::<u64>().ok()).unwrap_or(0);
        let validity = Validity { from: unix_time(), until: unix_time() + LIST_DUE };
        let list = self
            .authority_key
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

/// Writes a file atomically: a node may be reading it.
fn write(file: &Path, text: &str) -> Result<(), Diagnostic> {
    write_atomically(file, text, 0o644)
}

/// Writes a file that only its owner may read, atomically.
fn write_secret(file: &Path, text: &str) -> Result<(), Diagnostic> {
    write_atomically(file, text, 0o600)
}
