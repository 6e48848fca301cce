//! Connections to a server: TCP, and TLS over it for `https://`.

use std::env;
use std::fmt;
use std::io;
use std::sync::Arc;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{self, CertificateError, ClientConfig, RootCertStore};

use super::error::RequestError;

/// Environment variables that name files with certificates in place of those of the operating system.
const ROOT_VARIABLES: [&str; 2] = ["SSL_CERT_FILE", "SSL_CERT_DIR"];

/// An open connection.
pub(super) trait Connection: AsyncRead + AsyncWrite + Unpin {}

impl<T: AsyncRead + AsyncWrite + Unpin> Connection for T {}

/// Opens connections to one server.
pub(super) struct Connector {
    host: String,
    port: u16,
    tls: Option<Tls>,
}

/// TLS client, which trusts the certificate authorities of this host.
struct Tls {
    connector: TlsConnector,
    /// Name that the server's certificate must have.
    name: ServerName<'static>,
}

impl Connector {
    /// Creates a connector for `http://`.
    pub(super) const fn plain(host: String, port: u16) -> Self {
        Self { host, port, tls: None }
    }

    /// Creates a connector for `https://`. Reads the certificates of the authorities that this host trusts: those of
    /// the operating system, or those that `SSL_CERT_FILE` and `SSL_CERT_DIR` name.
    ///
    /// # Errors
    /// Returns the reason if the host is not a valid name, or if no certificate can be read.
    pub(super) fn tls(host: String, port: u16) -> Result<Self, String> {
        let name = ServerName::try_from(host.clone())
            .map_err(|error| format!("{host:?} is no host name or address for TLS: {error}"))?;
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut config = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| format!("TLS cannot be set up: {error}"))?
            .with_root_certificates(trusted_roots()?)
            .with_no_client_auth();
        // `exchange` in server.rs speaks only HTTP/1.
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Self { host, port, tls: Some(Tls { connector: TlsConnector::from(Arc::new(config)), name }) })
    }

    /// Opens a connection; the TLS handshake is part of it.
    ///
    /// # Errors
    /// If the server cannot be reached, if the handshake fails, or if the certificate is not valid for the server's
    /// name.
    pub(super) async fn connect(&self) -> Result<Box<dyn Connection>, RequestError> {
        let failed = |error: io::Error| RequestError::Connect(error.to_string());
        let stream = TcpStream::connect((self.host.as_str(), self.port)).await.map_err(failed)?;
        // Nagle's algorithm (RFC 896) could hold the end of a request back until its start is acknowledged.
        stream.set_nodelay(true).map_err(failed)?;
        let Some(Tls { connector, name }) = &self.tls else { return Ok(Box::new(stream)) };
        match connector.connect(name.clone(), stream).await {
            Ok(stream) => Ok(Box::new(stream)),
            Err(error) => {
                let remedy = remedy(error.get_ref().and_then(|inner| inner.downcast_ref()));
                Err(RequestError::Tls { server: self.to_string(), reason: error.to_string(), remedy })
            }
        }
    }

    /// Returns what is needed before a request can be sent, as text for messages.
    pub(super) const fn connection_text(&self) -> &'static str {
        if self.tls.is_some() { "connection with a complete TLS handshake" } else { "connection" }
    }
}

impl fmt::Display for Connector {
    /// Writes host and port.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.host.contains(':') {
            write!(f, "[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{}:{}", self.host, self.port)
        }
    }
}

/// Reads the certificates of the authorities that this host trusts.
fn trusted_roots() -> Result<RootCertStore, String> {
    let found = rustls_native_certs::load_native_certs();
    let mut roots = RootCertStore::empty();
    // Some hosts have old certificates that rustls cannot read. These are ignored if at least one certificate is
    // readable.
    let (trusted, unreadable) = roots.add_parsable_certificates(found.certs);
    let errors = found.errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    if trusted == 0 {
        let errors = if errors.is_empty() { String::new() } else { format!(": {errors}") };
        return Err(format!(
            "TLS needs the certificates of trusted authorities, but {} could be read from {}{errors}; install the package \
             ca-certificates, or name a PEM file in the environment variable SSL_CERT_FILE",
            if unreadable == 0 { "none".to_owned() } else { format!("0 of {unreadable}") },
            source_of_roots(),
        ));
    }
    if !errors.is_empty() {
        tracing::warn!(trusted, from = source_of_roots(), %errors, "some certificates of trusted authorities cannot be read");
    }
    Ok(roots)
}

/// Returns the source of the certificates of trusted authorities, for messages.
fn source_of_roots() -> String {
    let variables = ROOT_VARIABLES
        .into_iter()
        .filter_map(|name| env::var_os(name).map(|value| format!("{name}={}", value.to_string_lossy())));
    let variables: Vec<String> = variables.collect();
    if variables.is_empty() { "the operating system".to_owned() } else { variables.join(" and ") }
}

/// Returns what to do after a failed handshake.
fn remedy(error: Option<&rustls::Error>) -> String {
    use rustls::Error::{InvalidCertificate, InvalidMessage};
    match error {
        // The signature is bad if the server's authority has the name of a trusted authority, but another key; for
        // example, because the authority was created again.
        Some(InvalidCertificate(CertificateError::UnknownIssuer | CertificateError::BadSignature)) => format!(
            "its certificate is signed by no authority of {}: add this authority to those of the operating system, or name \
             a PEM file with all trusted authorities in the environment variable SSL_CERT_FILE",
            source_of_roots()
        ),
        Some(InvalidCertificate(
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
        )) => "write a name of the certificate into url".to_owned(),
        Some(InvalidCertificate(
            CertificateError::Expired
            | CertificateError::ExpiredContext { .. }
            | CertificateError::NotValidYet
            | CertificateError::NotValidYetContext { .. },
        )) => "renew the certificate, or set the clock of this host".to_owned(),
        Some(InvalidCertificate(_)) => {
            "give the server a certificate for a TLS server, which is not that of an authority (basicConstraints CA:FALSE)"
                .to_owned()
        }
        Some(InvalidMessage(_)) => "write http:// into url if this port has no TLS".to_owned(),
        _ => "check that url names a server with TLS 1.2 or 1.3".to_owned(),
    }
}
