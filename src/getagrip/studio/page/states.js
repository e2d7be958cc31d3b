// What an object may do, as the page says it. The names are those of clip.json's segments.

export const STATES = {
  static: { key: "t", word: "lies still", about: "It does not move in the world. A hand may touch it already." },
  contact: { key: "c", word: "unstable contact", about: "A hand moves it, but not in a stable grasp: it slides, is pushed, is gripped anew." },
  grasp: { key: "g", word: "stable grasp", about: "It is held by the same places, as above." },
  free: { key: "f", word: "moves freely", about: "It moves, and no hand touches it." },
};
