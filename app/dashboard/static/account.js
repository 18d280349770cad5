// Who is signed in: the key, kept for this tab only, and what it may do.

import { Api } from "./api.js";

const SLOT = "isodyn.key";

/** The key of this tab, or null. */
export function storedSecret() {
  return sessionStorage.getItem(SLOT);
}

/** Forget the key. */
export function forget() {
  sessionStorage.removeItem(SLOT);
}

/** Ask the service about a key; keeps it if it is good, throws the problem if not. */
export async function signIn(secret, onUnauthorized) {
  const key = await new Api(secret).get("/v1/keys/current");
  sessionStorage.setItem(SLOT, secret);
  return new Account(key, new Api(secret, { onUnauthorized }));
}

/** A key that works. */
export class Account {
  constructor(key, api) {
    this.key = key;
    this.api = api;
  }

  /** Whether the key may do what this scope names; null: what every key may. */
  may(scope) {
    return scope === null || scope === undefined || this.key.scopes.includes(scope) || this.key.scopes.includes("admin");
  }
}
