"use strict";
/* Chunks of data: scripts that call explorer.receive with base64 of gzip of JSON. They are loaded when wanted, since a
   page on file:// may not fetch, and the least used are dropped. */

const explorer = { views: {}, PAGE: 50 };

{
  const KEPT = 40;
  const FOLDER = "data/";
  const waiting = new Map();
  const kept = new Map();

  async function decoded(text) {
    const bytes = Uint8Array.fromBase64
      ? Uint8Array.fromBase64(text)
      : Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).json();
  }

  /* Called by each chunk. */
  explorer.receive = (name, text) => {
    const asked = waiting.get(name);
    if (asked) decoded(text).then(asked.resolve, asked.reject);
  };

  /* Return a promise of a chunk's document. With `keep` false the document is not kept. */
  explorer.load = (name, keep = true) => {
    if (kept.has(name)) {
      const found = kept.get(name);
      kept.delete(name);
      kept.set(name, found);
      return found;
    }
    const script = document.createElement("script");
    const found = new Promise((resolve, reject) => {
      waiting.set(name, { resolve, reject });
      script.onerror = () => reject(new Error(`the file ${FOLDER}${name}.js is missing`));
    });
    script.src = `${FOLDER}${name}.js`;
    document.head.append(script);
    const done = () => {
      waiting.delete(name);
      script.remove();
    };
    found.then(done, () => {
      done();
      kept.delete(name);
    });
    if (keep) {
      kept.set(name, found);
      if (kept.size > KEPT) kept.delete(kept.keys().next().value);
    }
    return found;
  };
}
