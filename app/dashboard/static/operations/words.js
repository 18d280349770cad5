// What things are called.

const KINDS = { locate_segment: "Segments", build_map: "Map builds", contribute: "Contributions" };

/** What a kind of job is called. */
export function kindName(kind) {
  return KINDS[kind] ?? kind;
}
