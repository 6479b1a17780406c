// Says what went wrong, until something goes right.

import { Refused } from "./api.js";

const place = document.getElementById("trouble");

let ofConnection = false;

export const complain = (error) => {
  ofConnection = false;
  place.hidden = !error;
  place.textContent = error ? error.message || String(error) : "";
  if (error && !(error instanceof Refused)) console.error(error);
};

// Does what a button asks, and says why it could not.
export const attempt = async (act) => {
  try {
    const result = await act();
    complain(null);
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
