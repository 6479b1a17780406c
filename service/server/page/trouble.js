// Says what went wrong, until something goes right.

import { Refused } from "./api.js";

const place = document.getElementById("trouble");

let ofConnection = false;
let complaints = 0;

export const complain = (error) => {
  ofConnection = false;
  if (error) complaints += 1;
  place.hidden = !error;
  place.textContent = error ? error.message || String(error) : "";
  if (error && !(error instanceof Refused)) console.error(error);
};

// Does what a button asks, and says why it could not. What goes right takes back only what was
// said before it began: a list that was still loading leaves the refusal of a token where it is.
export const attempt = async (act) => {
  const before = complaints;
  try {
    const result = await act();
    if (complaints === before) complain(null);
    return result;
  } catch (error) {
    complain(error);
    return undefined;
  }
};

// A connection that is there takes back only its own complaint, not that of a button.
export const connected = (there) => {
  if (there && ofConnection) complain(null);
  if (there) return;
  complain(new Refused(0, "The service does not answer. This page goes on when it is back."));
  ofConnection = true;
};
