//! Assets of the pages: style sheets, scripts, the font and the icon. The binary contains the assets, so that the pages
//! work without a network.
//!
//! Assets are served below `/static/HASH/`, where HASH is a hash of all assets. A browser may therefore cache an asset
//! without limit, and fetches the asset again after an update. Compressible assets are compressed once, when the server
//! starts.

use std::hash::{DefaultHasher, Hasher};
use std::io::Write as _;
use std::sync::LazyLock;

use axum::extract::Path;
use axum::http::header::{ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_TYPE, VARY};
use axum::http::{HeaderMap, HeaderValue};
use axum::response::{IntoResponse, Redirect, Response};
use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;

use crate::error::WebError;

struct Asset {
    name: &'static str,
    content_type: &'static str,
    plain: Bytes,
    /// Compressed contents; `None` for an asset whose format is compressed already.
    gzipped: Option<Bytes>,
}

struct Assets {
    /// Hash of the names and contents of all assets.
    version: String,
    all: Vec<Asset>,
}

const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

static ASSETS: LazyLock<Assets> = LazyLock::new(|| {
    macro_rules! css {
        ($($file:literal),*) => {
            concat!($(include_str!(concat!("../assets/css/", $file, ".css"))),*).as_bytes()
        };
    }
    let files: [(&str, &str, &'static [u8]); 12] = [
        (
            "app.css",
            "text/css; charset=utf-8",
            css!("tokens", "base", "frame", "parts", "tables", "pictures", "compare", "widths"),
        ),
        ("theme.js", JAVASCRIPT, include_bytes!("../assets/js/theme.js")),
        ("app.js", JAVASCRIPT, include_bytes!("../assets/js/app.js")),
        ("live.js", JAVASCRIPT, include_bytes!("../assets/js/live.js")),
        ("numbers.js", JAVASCRIPT, include_bytes!("../assets/js/numbers.js")),
        ("charts.js", JAVASCRIPT, include_bytes!("../assets/js/charts.js")),
        ("live-charts.js", JAVASCRIPT, include_bytes!("../assets/js/live-charts.js")),
        ("run.js", JAVASCRIPT, include_bytes!("../assets/js/run.js")),
        ("echarts.min.js", JAVASCRIPT, include_bytes!("../assets/echarts.min.js")),
        ("inter.woff2", "font/woff2", include_bytes!("../assets/inter.woff2")),
        ("icon.svg", "image/svg+xml", include_bytes!("../assets/icon.svg")),
        (
            "licences.txt",
            "text/plain; charset=utf-8",
            concat!(include_str!("../assets/echarts.LICENSE"), "\n", include_str!("../assets/inter.LICENSE"))
                .as_bytes(),
        ),
    ];
    // `DefaultHasher::new()` has no random key, so a restart of the same program keeps the addresses of the assets.
    let mut hasher = DefaultHasher::new();
    for (name, _, bytes) in &files {
        hasher.write(name.as_bytes());
        hasher.write(bytes);
    }
    let all = files.into_iter().map(|(name, content_type, bytes)| Asset {
        name,
        content_type,
        plain: Bytes::from_static(bytes),
        gzipped: if name.ends_with(".woff2") { None } else { gzip(bytes) },
    });
    Assets { version: format!("{:016x}", hasher.finish()), all: all.collect() }
});

/// Compresses an asset. Returns `None` if the compression fails; the asset is then served uncompressed.
fn gzip(bytes: &[u8]) -> Option<Bytes> {
    // The best compression is slow, but an asset is compressed only once.
    let mut encoder = GzEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::best());
    encoder.write_all(bytes).ok()?;
    encoder.finish().ok().map(Bytes::from)
}

/// Compresses all assets, so that the first request does not wait for the compression.
pub(crate) fn compress_all() {
    LazyLock::force(&ASSETS);
}

/// Returns the path of the current assets: `/static/HASH`.
pub(crate) fn base_path() -> String {
    format!("/static/{}", ASSETS.version)
}

/// Returns whether an `Accept-Encoding` names gzip with a weight other than zero (RFC 9110, section 12.5.3).
fn accepts_gzip(header: &str) -> bool {
    header.split(',').any(|coding| {
        let mut parts = coding.split(';').map(str::trim);
        let is_gzip = parts.next().is_some_and(|name| name.eq_ignore_ascii_case("gzip"));
        let weight = parts.find_map(|part| part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")));
        is_gzip && weight.is_none_or(|weight| weight.parse::<f32>().is_ok_and(|weight| weight > 0.0))
    })
}

/// `GET /static/{version}/{name}`.
pub(crate) async fn serve(
    Path((version, name)): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, WebError> {
    let asset = ASSETS.all.iter().find(|asset| asset.name == name);
    let asset = asset.ok_or_else(|| WebError::NotFound(format!("no static file is named {name}")))?;
    if version != ASSETS.version {
        // A page that was loaded before an update of this program requests the old address of the asset.
        return Ok(Redirect::temporary(&format!("{}/{name}", base_path())).into_response());
    }
    let accepts = |value: &HeaderValue| value.to_str().is_ok_and(accepts_gzip);
    let gzipped = asset.gzipped.as_ref().filter(|_| headers.get_all(ACCEPT_ENCODING).iter().any(accepts));
    let headers_of_asset = [
        (CONTENT_TYPE, asset.content_type),
        // The address contains a hash of the contents. Changed contents therefore have another address, and a browser
        // never has to ask whether its copy is current.
        (CACHE_CONTROL, "public, max-age=31536000, immutable"),
        // A proxy must not give the compressed form to a client that cannot decompress it.
        (VARY, "accept-encoding"),
    ];
    Ok(match gzipped {
        Some(bytes) => (headers_of_asset, [(CONTENT_ENCODING, "gzip")], bytes.clone()).into_response(),
        None => (headers_of_asset, asset.plain.clone()).into_response(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_accepted_unless_its_weight_is_zero() {
        for header in ["gzip", "br, gzip", "GZIP;q=0.5, *", "deflate;q=0, gzip ; q=1"] {
            assert!(accepts_gzip(header), "{header}");
        }
        for header in ["", "br", "gzip;q=0", "gzip; q=0.000", "x-gzipped", "gzip;q=nan"] {
            assert!(!accepts_gzip(header), "{header}");
        }
    }
}
