//! Configuration fragments, as a person publishes them, looks at them and goes back.
//!
//! In: a person's connection, a target, a text. Out: the number of what was published, or all that is there.

use crate::client::{Client, text};
use crate::connect::ANSWER_WITHIN;
use crate::fragments::{FRAGMENT_MAX, Fragment, Published, Shelf};
use crate::network::{entries, published, refusal_sentence};
use crate::payloads::{VERSION, encode};
use crate::subjects::Target;
use crate::words::sha256;
use futures_util::StreamExt;
use std::time::Duration;
use tokio::time::timeout;

/// All that was published for a target, over a slow network.
const HISTORY_WITHIN: Duration = Duration::from_secs(30);

impl Client {
    /// Publishes a fragment; an empty text takes back what there is. Its number comes back.
    ///
    /// # Errors
    /// It is too long, or the server does not take it.
    pub async fn publish_fragment(&self, target: &Target, content: &str, unix_s: f64) -> Result<u64, String> {
        if content.len() > FRAGMENT_MAX {
            let bytes = content.len();
            return Err(format!("the fragment has {bytes} bytes, at most {FRAGMENT_MAX} are taken"));
        }
        let fragment =
            Fragment { version: VERSION, text: content.to_string(), sha256: sha256(content), unix_s };
        let bytes = encode(&fragment).map_err(text)?;
        let key = target.config_key(&self.user);
        let put = timeout(ANSWER_WITHIN, self.server.config.put(key, bytes.into()));
        match self.permitted("shared configuration", put).await? {
            Ok(Ok(revision)) => Ok(revision),
            Ok(Err(error)) => Err(refusal_sentence("shared configuration", &error.to_string())),
            Err(_) => {
                Err("the server did not answer; `celld fleet config show` has what is there".to_string())
            }
        }
    }

    /// The newest fragment of each target.
    ///
    /// # Errors
    /// What the server says.
    pub async fn fragments(&self) -> Result<Shelf, String> {
        let mut shelf = Shelf::default();
        let found = entries(&self.server.config, ">").await?;
        found.into_iter().filter_map(published).for_each(|published| shelf.put(published));
        Ok(shelf)
    }

    /// All fragments of a target that the server still has, by whoever published them, the newest last.
    ///
    /// # Errors
    /// What the server says.
    pub async fn fragment_history(&self, target: &Target) -> Result<Vec<Published>, String> {
        let read = timeout(HISTORY_WITHIN, async {
            let mut found = Vec::new();
            let mut keys = self.server.config.keys().await.map_err(text)?;
            while let Some(key) = keys.next().await {
                let key = key.map_err(text)?;
                if Target::of_config_key(&key).is_none_or(|(of, _)| of != *target) {
                    continue;
                }
                let mut history = self.server.config.history(&key).await.map_err(text)?;
                while let Some(entry) = history.next().await {
                    found.extend(published(entry.map_err(text)?));
                }
            }
            Ok::<_, String>(found)
        });
        let mut found = read.await.map_err(|_| "the server does not go on".to_string())??;
        found.sort_by_key(|published| published.revision);
        Ok(found)
    }
}
